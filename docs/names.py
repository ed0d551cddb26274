"""Names of the package in the guide: docstrings prepared for Sphinx, and references under the public name."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
from functools import cache
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.inspect import TypeAliasForwardRef

import mfc_analysis

#: types that print as in the source, not as what they stand for
ALIASES = ("Array", "ArrayLike", "Bools", "Complex", "Ints", "Matrix", "Rule", "Value", "Vector")
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


def prepare(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """``|s|`` is an absolute value, not a substitution; and what stands before a colon in the text of an attribute is not its type."""
    lines[:] = LITERAL.sub(lambda found: found[1] or r"\|", "\n".join(lines)).split("\n")
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]


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


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", load_types)
    app.connect("autodoc-process-docstring", prepare, priority=400)
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True}
