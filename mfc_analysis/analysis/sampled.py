r"""The loop with a sampled controller: exact at the sampling instants.

Every ``sample_time`` h the controller reads its measurements, computes, and holds its torque (velocity) until the next sample::

    torque(k) --> [dead time] --> hold --> plant, continuous --> position, rate, force --> [dead time of the force] --> measured at t_k

- The plant is advanced by its matrix exponential under the held torque. A dead time of d + f samples adds d (+ 1) held values as states,
  and the torque switches inside the sample at the exact time. There is no Pade approximation and no "half a sample of delay".
- The force measured through a dead time is the force at t_k - T: the plant's solution between samples, then a register.
- The controller's states obey their linear differential equations with the measurements held over the sample: an integral becomes a
  forward sum, filters and linear outer loops become their zero-order-hold equivalents. Those that are ``stepped`` are sampled code.
- External inputs are also held over the sample; outputs are those at t_k.

With all wires cut the controller acts on the plant through the torque (velocity) wires only; this is checked.

Source: Astrom & Wittenmark, Computer-Controlled Systems, chapter 3 (sampling of systems with time delay).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mfc_analysis.analysis.channels import has_rate
from mfc_analysis.analysis.system import OpenSystem
from mfc_analysis.errors import BadArgument, Unsupported
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Bools, Ints
from mfc_analysis.maths.zero_order_hold import zero_order_hold

MOST_STATES = 2100  #: of the discrete model: the eigenvalues of one point take about half a minute
MOST_ENTRIES = 30_000_000  #: of the A of all points together: with the copies that an analysis makes about 2 GiB
WHOLE = 1e-9  #: a dead time this close to a whole number of samples counts as whole


@dataclass(frozen=True, eq=False)
class Layout:
    """Indices into Z = [states; registers; inputs]."""

    plant: Ints  #: plant states in Z
    control: Ints  #: controller states in Z
    external: Ints  #: external inputs in Z
    wires: Ints  #: (nw,) wire inputs in Z
    drive: Ints  #: (nd,) driving wires (torque or velocity) among the nw
    whole: Ints  #: (nw,) whole samples of dead time
    part: Array  #: (nw,) remaining fraction of a sample
    first: Ints  #: (nw,) first register of each wire in Z, -1 if it has none
    size: int  #: size of Z
    registers: int

    def past(self, wire: int, samples: int) -> int:
        """Index in Z of the value that entered a driving wire ``samples`` samples ago."""
        return int(self.wires[wire] if samples == 0 else self.first[wire] + samples - 1)


def sampled(system: OpenSystem, sample_time: float, *, on_wires: bool = False) -> OpenSystem:
    """The loop with a sampled controller: discrete (``dt`` = ``sample_time`` [s]), dead time included, wires still cut.

    ``on_wires``: whole samples of dead time are no states but stay on their wires (``wire_delay``), as z^-d; fractions of a sample are
    included all the same.

    States keep their order and names; the held values of dead times follow, such as "torque[-1] joint", one sample old. The analysis
    points are those of the continuous loop, except "position" where the velocity is measured too: that wire has no exact sampled counterpart
    of "s times the position".

    Raises ``BadArgument`` for a sample time that is not positive or so long that the plant overflows, ``Unsupported`` where the controller
    acts on the plant other than through its torque (velocity) wires, where a wire other than these or "force" has dead time, where the
    loop is already sampled, or where the samples in transit make the model too large.
    """
    h = checks.number("sample_time", sample_time, low=0.0, strict=True)
    layout, late = layout_of(system, h, on_wires)
    nx, nu, ny = system.nx, system.nu, system.ny
    Z = np.zeros((len(system.times), nx + layout.registers, layout.size))
    Z[:, layout.plant] = advanced(system, layout, h, h)
    Z[:, layout.control] = _controlled(system, layout, h)
    rows = np.zeros((len(system.times), ny + system.nw, layout.size))
    rows[:, :, :nx] = system.C
    rows[:, :, layout.external] = system.D[:, :, :nu]
    _add_wires(rows, system.D[:, :, nu:], layout)
    for wire in np.flatnonzero(layout.first >= 0):
        start, depth = int(layout.first[wire]), int(layout.whole[wire] + (layout.part[wire] > 0))
        Z[:, np.arange(start + 1, start + depth), np.arange(start, start + depth - 1)] = 1.0
        if wire in layout.drive:
            Z[:, start, layout.wires[wire]] = 1.0
            continue
        Z[:, start] = _seen(system, layout, int(wire), h) if layout.part[wire] > 0 else rows[:, ny + wire]
        rows[:, ny + wire] = 0.0
        rows[:, ny + wire, start + depth - 1] = 1.0
    if not (np.isfinite(Z).all() and np.isfinite(rows).all()):
        raise BadArgument("sample_time", h, "a shorter sample time: the plant overflows within this one")
    n = nx + layout.registers
    return replace(
        system,
        A=np.ascontiguousarray(Z[:, :, :n]),
        B=np.ascontiguousarray(Z[:, :, n:]),
        C=np.ascontiguousarray(rows[:, :, :n]),
        D=np.ascontiguousarray(rows[:, :, n:]),
        state_names=system.state_names + _names(system, layout),
        wire_delay=late,
        points=tuple(point for point in system.points if not has_rate(system, point)),
        plant_states=tuple(system.plant_states) + tuple(range(nx, n)),
        dt=h,
        registers=layout.registers,
        held=system,
    )


def layout_of(system: OpenSystem, h: float, on_wires: bool = False) -> tuple[Layout, Array]:
    """The indices, and (nw,) the dead time [s] that stays on the wires."""
    if system.dt:
        raise Unsupported("sample_time", h, f"a continuous loop; this one is already sampled, every {system.dt:g} s")
    nx, nu, nw = system.nx, system.nu, system.nw
    plant = np.array(sorted(system.plant_states), int)
    control = np.setdiff1d(np.arange(nx), plant)
    name = next((point for point in ("torque", "velocity") if point in system.wires), None)
    if name is None or plant.size == 0:
        raise Unsupported("sample_time", h, "a loop with torque or velocity wires to the plant")
    drive = np.arange(nw)[system.wires[name]]
    past_wires = np.abs(system.A[:, plant[:, None], control]).max(initial=0.0)
    others = nu + np.setdiff1d(np.arange(nw), drive)
    past_wires = max(past_wires, np.abs(system.B[:, plant[:, None], others]).max(initial=0.0))
    seen = system.C[:, system.ny + np.arange(nw)[system.wires["force"]]][:, :, control] if "force" in system.wires else np.zeros(1)
    if past_wires > 1e-12 * (1 + np.abs(system.A).max(initial=0.0)) or np.any(seen):
        raise Unsupported("sample_time", h, f"a loop whose controller acts on the plant through its {name} wires only")
    samples = system.wire_delay / h
    whole = np.floor(samples + WHOLE).astype(int)
    part = np.where(samples - whole > WHOLE, samples - whole, 0.0)
    late = whole * h if on_wires else np.zeros(nw)
    whole = np.zeros_like(whole) if on_wires else whole
    depth = whole + (part > 0)
    allowed = np.isin(np.arange(nw), drive)
    if "force" in system.wires:
        allowed[system.wires["force"]] = True
    if np.any(depth[~allowed]) or np.any(late[~allowed]):
        raise Unsupported("sample_time", h, f"dead time on the {name} and force wires only")
    registers = int(depth.sum())
    n, m = nx + registers, len(system.times)
    if n > MOST_STATES or m * n * n > MOST_ENTRIES:
        most = min(MOST_STATES, int(np.sqrt(MOST_ENTRIES / m)))
        raise Unsupported("sample_time", h, f"a model of at most {most} states at {m} times; the samples in transit make {n}. A longer one has fewer")
    first = np.where(depth > 0, nx + np.cumsum(depth) - depth, -1)
    external, wires = nx + registers + np.arange(nu), nx + registers + nu + np.arange(nw)
    return Layout(plant, control, external, wires, drive, whole, part, first, nx + registers + nu + nw, registers), late


def advanced(system: OpenSystem, layout: Layout, h: float, time: float) -> Array:
    """The plant at ``time`` into the sample (0 < time <= h), (m, np, size of Z): each held torque switches after its dead time."""
    p, nu = layout.plant, system.nu
    A = system.A[:, p[:, None], p]
    B = system.B[:, p[:, None], np.concatenate([np.arange(nu), nu + layout.drive])]
    switches = layout.part[layout.drive] * h
    edges = np.unique(np.concatenate([[0.0], switches[switches < time], [time]]))
    out = np.zeros((len(A), p.size, layout.size))
    out[:, np.arange(p.size), p] = 1.0
    for start, end in pairwise(edges.tolist()):
        Phi, Gamma = zero_order_hold(A, B, end - start)
        out = Phi @ out
        out[:, :, layout.external] += Gamma[:, :, :nu]
        for column, (wire, switch) in enumerate(zip(layout.drive, switches, strict=True), start=nu):
            out[:, :, layout.past(wire, int(layout.whole[wire]) + int(end <= switch))] += Gamma[:, :, column]
    return out


def _controlled(system: OpenSystem, layout: Layout, h: float) -> Array:
    """The controller's states one sample later, (m, nc, size of Z), with its measurements held."""
    c, p, nu = layout.control, layout.plant, system.nu
    held = np.zeros((len(system.A), c.size, layout.size))
    held[:, :, p] = system.A[:, c[:, None], p]
    held[:, :, layout.external] = system.B[:, c, :nu]
    _add_wires(held, system.B[:, c, nu:], layout)
    A = system.A[:, c[:, None], c]
    if (A[:1] == A).all():  # the equations of most laws' states are the same at all points: one exponential for all
        A = A[:1]
    advance = own_step(A, np.isin(c, system.stepped), h)
    held[:, :, c] += A
    out = advance @ held
    out[:, :, c] += np.eye(c.size)
    return out


def own_step(A: Array, stepped: Bools, h: float) -> Array:
    """What takes the rates A x + (what is held) of a controller's k states x to their change over a sample: h phi_1(h A), (..., k, k).

    A: (..., k, k). A state that is ``stepped`` (k,) changes by h times its rate, and is held for the others.
    """
    smooth = np.where(stepped[:, None] | stepped, 0.0, A)
    return zero_order_hold(smooth, np.broadcast_to(np.eye(A.shape[-1]), A.shape), h)[1]


def _seen(system: OpenSystem, layout: Layout, wire: int, h: float) -> Array:
    """Signal that a delayed sensor reports later: at (1 - part) h into the sample, (m, size of Z)."""
    time = (1 - layout.part[wire]) * h
    row = system.ny + wire
    out = (system.C[:, row : row + 1, layout.plant] @ advanced(system, layout, h, time))[:, 0]
    out[:, layout.external] += system.D[:, row, : system.nu]
    rows = out[:, None, :]
    _add_wires(rows, system.D[:, row : row + 1, system.nu :], layout, 1 - float(layout.part[wire]))
    return rows[:, 0]


def _add_wires(rows: Array, D: Array, layout: Layout, age: float = 0.0) -> None:
    """Direct terms of the wires: the delayed value acts, at ``age`` samples into the sample."""
    for wire in range(D.shape[-1]):
        place = layout.wires[wire]
        if wire in layout.drive:
            place = layout.past(wire, int(layout.whole[wire]) + int(age < layout.part[wire]))
        rows[:, :, place] += D[:, :, wire]


def _names(system: OpenSystem, layout: Layout) -> tuple[str, ...]:
    point = {int(w): name for name, where in system.wires.items() for w in np.arange(system.nw)[where]}
    found = []
    for wire in np.flatnonzero(layout.first >= 0):
        depth = int(layout.whole[wire] + (layout.part[wire] > 0))
        found += [f"{point[int(wire)]}[-{k}] {system.wire_names[wire]}" for k in range(1, depth + 1)]
    return tuple(found)
