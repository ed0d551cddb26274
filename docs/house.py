"""The picture of the house: the rooms of the package on their floors, drawn from the table that ``tests/test_house.py`` enforces."""

from __future__ import annotations

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
WIDTH, HEIGHT, ROW, GAP = 128, 40, 74, 22


def table() -> tuple[dict[str, set[str]], dict[str, str]]:
    """Room -> the rooms that it may import; library -> the only room that imports it."""
    spec = importlib.util.spec_from_file_location("house_table", ROOT / "tests" / "test_house.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return {room: below for room, below in module.FLOORS.items() if room != "__main__"}, module.LIBRARIES


def svg() -> str:
    """A box for each room, on the floor above the highest one that it may import; a line where no third room is between the two."""
    below, libraries = table()
    only = {room: library.replace("solve_ivp", "ODE solver") for library, room in libraries.items()}
    floor: dict[str, int] = {"errors": 0}
    while len(floor) < len(below):
        floor |= {room: 1 + max((floor[b] for b in under), default=0) for room, under in below.items() if room not in floor and under <= floor.keys()}
    drawn = {room: [b for b in sorted(under) if not any(b in below[third] for third in under)] for room, under in below.items()}
    down = (1 + max(floor.values())) * ROW + GAP
    place: dict[str, tuple[float, float]] = {}
    for k in range(1 + max(floor.values())):
        over = {
            room: sum(place[b][0] for b in drawn[room]) / len(drawn[room]) if drawn[room] else 0.0 for room in reversed(below) if floor[room] == k
        }
        row = sorted(over, key=over.__getitem__)
        left = sum(over.values()) / len(row) - (len(row) - 1) / 2 * (WIDTH + GAP)
        place |= {room: (left + i * (WIDTH + GAP), down - ROW * k - ROW / 2) for i, room in enumerate(row)}
    left, right = min(x for x, _ in place.values()) - WIDTH / 2, max(x for x, _ in place.values()) + WIDTH / 2
    place["errors"] = ((left + right) / 2, place["errors"][1])
    parts = []
    for room, under in drawn.items():
        for b in under:
            (x, y), (u, v) = place[room], place[b]
            middle = (y + v) / 2
            parts.append(f'<path d="M{x:.0f} {y + HEIGHT / 2:.0f} C{x:.0f} {middle:.0f} {u:.0f} {middle:.0f} {u:.0f} {v - HEIGHT / 2:.0f}"/>')
    for room, (x, y) in place.items():
        wide = right - left if room == "errors" else WIDTH
        lines = [room, f"only here: {only[room]}"] if room in only else [room]
        parts.append(f'<rect x="{x - wide / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{wide}" height="{HEIGHT}" rx="6"/>')
        for i, line in enumerate(lines):
            parts.append(f'<text class="{"small" if i else "room"}" x="{x:.0f}" y="{y + 5 - 8 * (len(lines) - 1) + 16 * i:.0f}">{line}</text>')
    style = (
        "rect{fill:#eef3f8;stroke:#3d5a80}path{fill:none;stroke:#8a97a6;stroke-width:1.4}text{font-family:sans-serif;text-anchor:middle;fill:#1b2733}"
    )
    style += ".room{font-size:15px;font-weight:600}.small{font-size:11px}"
    x, wide = left - GAP, right - left + 2 * GAP
    paper = f'<rect x="{x:.0f}" width="100%" height="100%" style="fill:#fff;stroke:none"/>'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{x:.0f} 0 {wide:.0f} {down}" width="{wide:.0f}" height="{down}">'
    return f"{head}<style>{style}</style>{paper}{''.join(parts)}</svg>"
