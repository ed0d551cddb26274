"""The smallest margins of a loop over all its analysis points: in a sentence, as key metrics, as numbers, as checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

from mfc_analysis.analysis.spectrum import rates
from mfc_analysis.report.chapter.pieces import at_least, at_most, margins_at, slowest
from mfc_analysis.report.document.document import Fact, KeyFacts, Number, written
from mfc_analysis.report.loops.points import Smallest, smallest
from mfc_analysis.report.loops.view import place_words
from mfc_analysis.requirements.line import Line, Status

if TYPE_CHECKING:
    from mfc_analysis.linearization.linearization import Linearization


def least(lin: Linearization) -> Mapping[str, Smallest]:
    """The smallest margins over all analysis points of a linearised loop."""
    return smallest([margins_at(lin, point) for point in lin.opened.points])


def tightest(lin: Linearization) -> str:
    """The smallest phase and delay margin of a loop over all its analysis points, as part of a sentence."""
    found = least(lin)
    phase, delay = found["phase_deg"], found["delay"]
    at, late = (place_words(x.where, x.when, len(lin)) for x in (phase, delay))
    return f"the smallest phase margin is {written(phase.value)}° ({at}) and the smallest delay margin {written(1e3 * delay.value)} ms ({late})"


def force_facts(lin: Linearization) -> KeyFacts:
    """The smallest phase, gain and delay margin over all analysis points."""
    m = least(lin)
    phase, gain, delay = m["phase_deg"], m["gain_increase_db"], m["delay"]
    return KeyFacts(
        (
            Fact("Phase margin", Number(phase.value, "°", infinite="no crossover", undefined="unstable"), phase.where),
            Fact("Gain margin", Number(gain.value, "dB", undefined="unstable"), gain.where),
            Fact("Delay margin", Number(1e3 * delay.value, "ms", infinite="no crossover", undefined="unstable"), delay.where),
        )
    )


def smallest_numbers(lin: Linearization) -> dict[str, object]:
    """The smallest margins over all analysis points with their places, by name."""
    return {"smallest": {name: asdict(found) for name, found in least(lin).items()}}


def margin_numbers(lin: Linearization) -> dict[str, object]:
    """The smallest margins over all analysis points with their places, and those at the force sensor's z, by name."""
    m = margins_at(lin, "force")
    names = ("phase_deg", "gain_increase", "gain_reduction", "delay", "sensitivity_peak", "crossover")
    return {
        **smallest_numbers(lin),
        "force": {name: float(getattr(m, name)[0, 2]) for name in names},
    }


def force_checks(lin: Linearization, phase: float, gain_db: float, peak: float) -> tuple[Line, ...]:
    """Checks of a force loop's smallest margins over all analysis points, under the names that all loops share."""
    m, slow = least(lin), slowest(rates(lin.poles()[0], lin.dt)).real
    up, down, late = m["gain_increase_db"], m["gain_reduction_db"], m["delay"]
    return (
        Line("stable", 0.0, slow, "1/s", -slow, Status.PASS if bool(lin.stable[0]) else Status.FAIL, "", None, "<"),
        at_least("phase margin", phase, m["phase_deg"].value, "°", m["phase_deg"].where),
        at_least("gain margin, up", gain_db, up.value, "dB", up.where),
        at_least("gain margin, down", gain_db, down.value, "dB", down.where),
        at_least("delay margin", 2.0, 1e3 * late.value, "ms", late.where),
        at_most("sensitivity peak", peak, m["sensitivity_peak"].value, "", m["sensitivity_peak"].where),
    )
