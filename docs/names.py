"""Names of the package in the guide: docstrings prepared for Sphinx, and references under the public name."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from contextlib import suppress
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

#: types that print as in the source, not as what they stand for
ALIASES = ("Array", "ArrayLike", "Bools", "Complex", "Ints", "Matrix", "Rule", "Tap", "Value", "Vector")
#: other libraries, whose pages cannot be reached without network
ELSEWHERE = r"(numpy|scipy|control|matplotlib|pinocchio|xarray|pathlib|os|typing|abc|enum|collections|datetime|types|functools)\."

TypeAliasForwardRef.__repr__ = lambda self: self.name  # an alias within a union
LITERAL = re.compile(r"(``.*?``|:\w+:`.*?`|^\.\. math::.*(?:\n+[ ]+.*)*)|\|", re.MULTILINE)


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


def one_each(lines: list[str], names: set[str]) -> list[str]:
    """``Args`` with an entry for each parameter: ``kp: [1/s^2], kd: [1/s]`` and ``a, b: [s]`` are two each."""
    out: list[str] = []
    inside, indent = False, 0
    for line in lines:
        if line.strip() in ("Args:", "Raises:", "Returns:", "Warns:"):
            inside, indent = line.strip() == "Args:", 0
        elif inside and line.strip():
            depth = len(line) - len(line.lstrip())
            indent = indent or depth
            inside = depth >= indent
            starts = "|".join(map(re.escape, sorted(names)))
            entries = list(re.finditer(rf"(?:^|[,;.] )((?:{starts})(?:, (?:{starts}))*): ", line.strip()))
            if inside and depth == indent and entries and entries[0].start() == 0:
                texts = [line.strip()[one.end() : after] for one, after in zip(entries, [one.start() for one in entries[1:]] + [None], strict=True)]
                out += [f"{' ' * indent}{name}: {text}" for one, text in zip(entries, texts, strict=True) for name in one[1].split(", ")]
                continue
        out.append(line)
    return out


def prepare(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """``|s|`` is an absolute value, no substitution; each parameter has its entry; what is before a colon in the text of an attribute is no type."""
    lines[:] = LITERAL.sub(lambda found: found[1] or r"\|", "\n".join(lines)).split("\n")
    if what in ("class", "exception", "function", "method"):
        with suppress(ValueError, TypeError):
            lines[:] = one_each(lines, set(inspect.signature(thing).parameters))
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]


def shortened(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, arguments: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """A default that is made anew each time as ``...``: with ``<factory>`` the signature is not one that Sphinx can read."""
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
    """``mfc.gains.pid(...)`` in the text of a page is a link to the reference."""

    default_priority = 5

    def run(self, **_: Any) -> None:
        for node in list(self.document.findall(nodes.literal)):
            found = re.fullmatch(r"mfc(?:_analysis)?\.([\w.]+)(?:\(.*\))?", node.astext(), re.DOTALL)
            name = f"mfc_analysis.{found[1]}" if found else ""
            known = self.env.domains.python_domain.objects.get(name)
            linked = any(isinstance(above, (nodes.reference, addnodes.pending_xref)) for above in ancestors(node))
            if known and known.docname != self.env.current_document.docname and not linked:
                to = make_refnode(self.app.builder, self.env.current_document.docname, known.docname, known.node_id, node.deepcopy(), name)
                node.replace_self(to)


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", load_types)
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("autodoc-process-signature", shortened)
    app.connect("missing-reference", resolve)
    app.add_post_transform(Links)
    return {"parallel_read_safe": True}
