"""Notebook display of results: one small HTML table each, or their text. Imports no other file of the package."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


class Shown:
    """A result that a notebook shows as its text: the first line in bold, the others below it as they are."""

    def _repr_html_(self) -> str:
        head, *rest = str(self).splitlines() or [""]
        return f"<p><strong>{escape(head)}</strong></p>" + (f"<pre>{escape(chr(10).join(rest))}</pre>" if rest else "")


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """An HTML table with row headers in the first column; all text is escaped."""
    head = "".join(f'<th scope="col">{escape(h)}</th>' for h in heads)
    body = "".join(f'<tr><th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:]) + "</tr>" for row in rows)
    below = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return f"<table><caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{below}"
