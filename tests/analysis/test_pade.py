"""Dead time by Pade approximation, against the exact loop."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.roots import delay_roots
from mfc_analysis.analysis.pade import with_pade
from mfc_analysis.analysis.system import close_wires
from mfc_analysis.errors import BadArgument, Unsupported
from tests.analysis.conftest import open_system

s = control.tf("s")


def test_the_roots_near_the_origin_are_those_of_the_loop_with_dead_time() -> None:
    system = open_system(8 * (s + 1) / (s * (s + 2) * (0.01 * s + 1)), delay=0.05)
    exact = delay_roots(system, 4)[0]
    approximate = np.linalg.eigvals(close_wires(with_pade(system, 10))[0][0])
    near = exact[np.abs(exact) * 0.05 < 4]
    assert len(near) >= 3
    for root in near:
        assert np.abs(approximate - root).min() < 1e-6 * abs(root)
    without = np.linalg.eigvals(close_wires(system)[0][0])
    assert max(np.abs(without - root).min() / abs(root) for root in near) > 0.1


def test_the_states_of_each_late_wire_come_last_and_are_named() -> None:
    system = open_system(s / (s + 1) ** 2, delay=0.2)
    found = with_pade(system, 3)
    assert found.state_names == (*system.state_names, "pade0_joint", "pade1_joint", "pade2_joint")
    assert not found.delayed and system.delayed and found.nx == system.nx + 3
    assert_allclose(found.A[:, : system.nx, : system.nx], system.A)
    prompt = open_system(s / (s + 1) ** 2)
    assert with_pade(prompt, 3) is prompt


@pytest.mark.parametrize("order", [0, 16, 2.5, True])
def test_the_order_is_1_to_15(order: object) -> None:
    with pytest.raises(BadArgument, match="pade"):
        with_pade(open_system(1 / s, delay=0.1), order)  # type: ignore[arg-type]


def test_a_sampled_loop_has_its_dead_time_already() -> None:
    with pytest.raises(Unsupported, match="exactly"):
        with_pade(open_system(control.c2d(control.ss(1 / (s + 1)), 0.1)), 3)
