"""M, J, X and their inverses at a joint position, shared kinematics, and where J is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import NearSingular
from mfc_analysis.robots.primitives import Primitives
from tests.conftest import arm, plant, regular_pose, seed
from tests.robots.test_primitives import EVERY


@pytest.mark.parametrize("name", ["ur5", "panda", "reordered", "branched"])
def test_the_matrices_are_those_of_the_robot(name: str) -> None:
    robot = EVERY[name]
    q = seed(name, "matrices").uniform(-1, 1, (3, robot.n)) + (regular_pose(name) if name in ("ur5", "panda") else 0.0)
    for i, at in ((slice(None), Primitives(robot).at(q)), (1, Primitives(robot).at(q[1]))):
        one = np.stack([robot.mass(x) for x in q])[i]
        assert_allclose(at.M, one, atol=1e-12)
        assert_allclose(at.M_inverse @ at.M, np.broadcast_to(np.eye(robot.n), one.shape), atol=1e-9)
        assert_allclose(at.J, np.stack([robot.jacobian(x) for x in q])[i], atol=1e-12)
        assert_allclose(at.R, np.stack([robot.pose(x)[:3, :3] for x in q])[i], atol=1e-12)
        assert_allclose(at.p, np.stack([robot.pose(x)[:3, 3] for x in q])[i], atol=1e-12)
        if robot.n >= 6:
            assert_allclose(at.Lambda @ (at.J @ at.M_inverse @ at.J_T), np.broadcast_to(np.eye(6), at.Lambda.shape), atol=1e-8)


@pytest.mark.parametrize(("angle", "refused"), [(5e-6, False), (4e-6, True), (0.0, True)])
def test_a_jacobian_is_refused_by_its_condition_number_even_where_its_inverse_exists(angle: float, refused: bool) -> None:
    """UR5 with the fifth joint near 0, where the fourth and the sixth axis are parallel."""
    P, q = Primitives(arm("ur5")), np.array([0.3, -1.2, 1.5, -0.8, angle, 0.3])
    condition = np.linalg.cond(P.at(q).J)
    assert (condition > 1e6) == refused
    for at in (P.at(q), P.at(q[None])):
        if refused:
            with pytest.raises(NearSingular) as why:
                at.check_regular()
            assert why.value.condition > 1e6
        else:
            at.check_regular()


@pytest.mark.parametrize("name", ["ur5", "panda", "continuous", "branched"])
def test_kinematics_are_shared_with_a_robot_that_moves_alike_and_with_no_other(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = EVERY[name]
    loaded = Primitives(robot.with_payload(1.5))
    shared, alone = Primitives(robot, loaded), Primitives(robot)
    q = seed(name, "shared").normal(size=(3, robot.n))
    assert shared.at(q).J is loaded.at(q).J and alone.at(q).J is not loaded.at(q).J
    for one in ("J", "R", "p", "M"):
        assert_allclose(getattr(shared.at(q), one), getattr(alone.at(q), one), atol=1e-14)
    assert not np.allclose(shared.at(q).M, loaded.at(q).M)
    other = Primitives(plant("ur10" if name == "ur5" else "ur5"))
    assert_allclose(Primitives(robot, other).at(q).J, alone.at(q).J, atol=1e-14)
