"""Names of the package in the guide: docstrings prepared for Sphinx, and references under the public name."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util.inspect import TypeAliasForwardRef
from sphinx.util.nodes import make_refnode

import mfc_analysis
from mfc_analysis import errors

#: types that print as in the source, not as what they stand for
ALIASES = ("Array", "ArrayLike", "Bools", "Complex", "Ints", "Matrix", "Rule", "Tap", "Value", "Vector")
#: what a name without its package is a link to: its page, not the line of an attribute
LINKED = ("class", "exception", "function", "method")
#: other libraries, whose pages cannot be reached without network
ELSEWHERE = r"(numpy|scipy|control|matplotlib|pinocchio|xarray|pathlib|os|typing|abc|enum|collections|datetime|types|functools)\."

TypeAliasForwardRef.__repr__ = lambda self: self.name  # an alias within a union
ERRORS = "|".join([*(name for name, thing in vars(errors).items() if inspect.isclass(thing)), "MissingRobots", "StudyError"])
LITERAL = re.compile(rf"(``.*?``|:\w+:`.*?`|^\.\. math::.*(?:\n+[ ]+.*)*|^ +\w+: )|\||\b({ERRORS})\b", re.MULTILINE)


def load_types(app: Sphinx) -> None:
    """Runs the imports under ``if TYPE_CHECKING``, so that every annotation has a meaning."""
    waiting = []
    for file in pkgutil.walk_packages(mfc_analysis.__path__, "mfc_analysis."):
        if not file.name.endswith(("__main__", "pytest_plugin")):
            module = importlib.import_module(file.name)
            tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
            waiting += [
                (module, part) for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING" for part in node.body
            ]
    for last in (False, False, True):
        late = []
        for module, part in waiting:
            try:
                exec(compile(ast.Module([part], []), str(module.__file__), "exec"), vars(module))
            except ImportError:  # of a name that the other module, too, has for types only
                if last:
                    raise
                late.append((module, part))
        waiting = late


def entries(text: str, names: set[str]) -> list[tuple[str, str]]:
    """(name, text) of each parameter of one entry of ``Args``: ``kp: [1/s^2], kd: [1/s]; scalar`` and ``a, b: [s]`` are two each."""
    starts = "|".join(map(re.escape, sorted(names)))
    found = list(re.finditer(rf"(?:^|[,;.] )((?:{starts})(?:, (?:{starts}))*): ", text.split("\n")[0]))
    if not found or found[0].start() > 0:
        return []
    texts = [text[one.end() : after] for one, after in zip(found, [one.start() for one in found[1:]] + [None], strict=True)]
    unit, tail = r"(?:\w+ )?\[[^]]*\]", ""
    for k, said in reversed(list(enumerate(texts))):
        if re.fullmatch(unit, said):
            texts[k] += tail  # what is said after the last of several units holds for all of them
        else:
            tail = more[1] if (more := re.match(rf"{unit}(; .*?)(?:\.\s|\.?$)", said, re.DOTALL)) else ""
    out: list[tuple[str, str]] = []
    for one, said in zip(found, texts, strict=True):
        first, *others = one[1].split(", ")
        out.append((first, said))
        out += [(name, said if len(said) < 60 else f"see ``{first}``.") for name in others]
    return out


def one_each(lines: list[str], names: set[str]) -> list[str]:
    """The docstring with an entry of its own for each parameter of ``Args``."""
    out: list[str] = []
    text = "\n".join(lines)
    args = re.search(r"^Args:\n((?:(?: .*)?\n)*(?: .*)?)", text, re.MULTILINE)
    if not args or not (indent := re.match(r"\n* +", args[1])):
        return lines
    for block in re.split(rf"\n(?={indent[0]}\S)", args[1].rstrip()):
        parts = entries(re.sub(rf"^{indent[0]}", "", block), names)
        out += [f"{indent[0]}{name}: {said}" for name, said in parts] or [block]
    return f"{text[: args.start(1)]}{chr(10).join(out)}{text[args.start(1) + len(args[1].rstrip()) :]}".split("\n")


def members(kind: type[Enum]) -> list[str]:
    """The members of an enumeration as a list, each with its value if that is more than its name."""
    return [f"- ``{one.name}``" + (f": {one.value}" if one.value != one.name else "") for one in kind]


def prepare(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """``|s|`` is an absolute value, no substitution; errors are names; what is before a colon in the text of an attribute is no type."""
    lines[:] = LITERAL.sub(lambda found: found[1] or (f"``{found[2]}``" if found[2] else r"\|"), "\n".join(lines)).split("\n")
    if what in ("class", "exception", "function", "method"):
        with suppress(ValueError, TypeError):
            lines[:] = one_each(lines, set(inspect.signature(thing).parameters))
    if inspect.isclass(thing) and issubclass(thing, Enum):
        lines += ["", *members(thing), ""]
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]


def skipped(app: Sphinx, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """The equation of a law as source text: the page shows it set."""
    return True if name == "typst" and thing else None


def shortened(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """A default that is made anew each time as ``...``: with ``<factory>`` the signature is not one that Sphinx can read. An enumeration has none."""
    if inspect.isclass(thing) and issubclass(thing, Enum):
        return "", None
    return arguments and arguments.replace("<factory>", "..."), returns


@cache
def named(name: str) -> Any:
    """The object of a dotted name, or None."""
    try:
        return pkgutil.resolve_name(name)
    except (ImportError, AttributeError, ValueError):
        return None


def resolve(app: Sphinx, env: Any, node: Any, text: Any) -> Any:
    """A reference by the private name, or by the last part alone, goes where the public name is. A private thing without a page is text."""
    target = node["reftarget"]
    if node.get("refdomain") != "py":
        return None
    if re.match(ELSEWHERE, target) or target in ALIASES:
        return text
    domain, last = env.domains.python_domain, target.rpartition(".")[2]
    thing = named(target) or named(f"{node.get('py:module')}.{target}")
    pages = [
        name for name, entry in domain.objects.items() if name.rpartition(".")[2] == last and entry.objtype in ("class", "exception", "function")
    ]
    pages = [name for name in pages if thing is None or named(name) is thing]
    if len(pages) == 1:
        return domain.resolve_xref(env, node["refdoc"], app.builder, "obj", pages[0], node, text)
    return None if thing is None else text


def ancestors(node: nodes.Node) -> Iterator[nodes.Node]:
    while node := node.parent:
        yield node


class Links(SphinxPostTransform):
    """A public name in the text of a page, ``mfc.gains.pid(...)``, ``gains.pid`` or ``Margins``, is a link to the reference."""

    default_priority = 5

    def target(self, text: str) -> Any:
        """(name, entry) of what a text names, also as seen from the page of a function or class beside it, else None."""
        objects, page = self.env.domains.python_domain.objects, self.env.current_document.docname
        found = re.fullmatch(r"(mfc(?:_analysis)?\.)?([\w.]+)(\(.*\))?", text, re.DOTALL)
        if not found:
            return None
        here = page.removeprefix("reference/") if page.startswith("reference/") and not found[1] else ""
        names = [f"mfc_analysis.{place}.{found[2]}" for place in (here, here.rpartition(".")[0]) if place] + [f"mfc_analysis.{found[2]}"]
        if not found[1] and re.fullmatch(r"[A-Z]\w*[a-z]\w*", found[2]):
            classes = [name for name in objects if name.rpartition(".")[2] == found[2] and objects[name].objtype in ("class", "exception")]
            names += classes if len(classes) == 1 else []
        return next(((name, objects[name]) for name in names if name in objects and (found[1] or objects[name].objtype in LINKED)), None)

    def run(self, **_: Any) -> None:
        for node in list(self.document.findall(nodes.literal)):
            page = self.env.current_document.docname
            linked = any(isinstance(above, (nodes.reference, addnodes.pending_xref, nodes.title)) for above in ancestors(node))
            if not linked and (known := self.target(node.astext())) and known[1].docname != page:
                name, entry = known
                node.replace_self(make_refnode(self.app.builder, page, entry.docname, entry.node_id, node.deepcopy(), name))


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", load_types)
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("autodoc-skip-member", skipped)
    app.connect("autodoc-process-signature", shortened)
    app.connect("missing-reference", resolve)
    app.add_post_transform(Links)
    return {"parallel_read_safe": True}
