"""Sweeps: axes, values, errors that stay with their points, closures over processes."""

import math
import os

import joblib
import numpy as np
import pytest
import xarray as xr

import mfc_analysis as mfc
from mfc_analysis.errors import BadArgument, MfcWarning


def velocity_p(k: float, lag: float = 1e-2):
    return mfc.ClosedLoop(mfc.robots.single_joint(), mfc.laws.VelocityP(k), mfc.trajectories.Hold([0.3]), hardware=mfc.Hardware(velocity_lag=lag))


def phase(loop) -> float:
    return loop.linearize([0.0]).margins().phase_deg[0, 0]


def test_values_stand_where_their_names_say():
    grid = {"k": [1.0, 5.0, 20.0], "lag": [1e-3, 1e-2]}
    found = mfc.sweep(velocity_p, grid, phase)
    assert isinstance(found, xr.DataArray) and found.dims == ("k", "lag") and found.shape == (3, 2)
    for k in grid["k"]:
        for lag in grid["lag"]:
            crossover = math.sqrt((math.sqrt(1 + (2 * k * lag) ** 2) - 1) / 2) / lag
            assert float(found.sel(k=k, lag=lag)) == pytest.approx(90 - math.degrees(math.atan(crossover * lag)), rel=1e-9)
    assert (found.error == "").all()


def test_a_mapping_becomes_a_dataset_and_arrays_get_axes_of_their_own():
    found = mfc.sweep(velocity_p, {"k": [1.0, 5.0]}, lambda loop: {"phase": phase(loop), "poles": loop.linearize([0.0]).poles()[0]})
    assert isinstance(found, xr.Dataset) and set(found) == {"phase", "poles"}
    assert found.poles.dims == ("k", "dim_0") and found.poles.shape == (2, 2) and found.poles.dtype.kind == "c"


def test_a_failed_point_is_recorded_with_its_error_and_the_others_are_kept():
    with pytest.warns(MfcWarning, match="1 of 3 points failed.*k=-1"):
        found = mfc.sweep(lambda k: velocity_p(k) if k > 0 else 1 / 0, {"k": [1.0, -1.0, 5.0]}, phase)
    assert np.isnan(found.sel(k=-1.0)) and np.isfinite(found.sel(k=[1.0, 5.0])).all()
    assert "ZeroDivisionError" in str(found.error.sel(k=-1.0).item()) and found.error.sel(k=1.0).item() == ""


def test_an_error_of_the_library_is_recorded_with_its_sentence():
    with pytest.warns(MfcWarning):
        found = mfc.sweep(
            velocity_p, {"k": [1.0], "lag": [-1.0, 1e-2]}, lambda loop: {"phase": phase(loop), "stable": bool(loop.linearize([0.0]).stable[0])}
        )
    assert "velocity_lag" in found.error.sel(k=1.0, lag=-1.0).item()
    assert np.isnan(found.phase.sel(lag=-1.0)).all() and np.isnan(found.stable.sel(lag=-1.0)).all() and found.stable.sel(lag=1e-2).item() == 1.0


def test_where_every_point_fails_the_errors_are_all_there():
    with pytest.warns(MfcWarning, match="2 of 2"):
        found = mfc.sweep(lambda k: 1 / 0, {"k": [1, 2]}, phase)
    assert np.isnan(found).all() and (found.error != "").all()


def test_closures_go_to_other_processes_and_give_the_same():
    factor = 2.0
    grid = {"k": [1.0, 5.0, 20.0]}
    alone = mfc.sweep(lambda k: velocity_p(factor * k), grid, lambda loop: phase(loop))
    spread = mfc.sweep(lambda k: velocity_p(factor * k), grid, lambda loop: {"phase": phase(loop), "process": os.getpid()}, n_jobs=2)
    np.testing.assert_allclose(spread.phase, alone, rtol=1e-12)
    assert not (spread.process == os.getpid()).any()


@pytest.mark.parametrize("backend", ["threading", "sequential"])
def test_the_backend_is_that_of_joblib(backend):
    with joblib.parallel_config(backend=backend):
        found = mfc.sweep(velocity_p, {"k": [1.0, 5.0]}, phase)
    assert np.isfinite(found).all()


def test_the_same_call_runs_on_a_dask_cluster():
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None), joblib.parallel_config(backend="dask"):
        found = mfc.sweep(velocity_p, {"k": [1.0, 5.0]}, phase)
    assert np.isfinite(found).all()


def test_words_and_objects_are_axes_too():
    robots = [mfc.robots.single_joint(), mfc.robots.planar_2r()]
    found = mfc.sweep(lambda robot, kind: robot.n if kind == "n" else robot.total_mass, {"robot": robots, "kind": ["n", "mass"]}, float)
    assert found.sel(kind="n").values.tolist() == [1.0, 2.0] and "planar_2r" in str(found.robot.values[1])


def test_progress_changes_nothing():
    assert mfc.sweep(velocity_p, {"k": [1.0]}, phase, progress=True).equals(mfc.sweep(velocity_p, {"k": [1.0]}, phase))


@pytest.mark.parametrize(
    ("build", "grid", "measure", "named"),
    [
        (3, {"k": [1]}, phase, "build"),
        (velocity_p, {"k": [1]}, "phase", "measure"),
        (velocity_p, {}, phase, "grid"),
        (velocity_p, {"k": []}, phase, "grid"),
        (velocity_p, {"k": "abc"}, phase, "grid"),
        (velocity_p, {"error": [1]}, phase, "grid"),
    ],
)
def test_bad_input_is_refused_by_name(build, grid, measure, named):
    with pytest.raises(BadArgument, match=named):
        mfc.sweep(build, grid, measure)


def test_results_that_do_not_fit_together_are_refused():
    with pytest.raises(BadArgument, match="one shape"):
        mfc.sweep(lambda k: k, {"k": [1, 2]}, lambda k: np.zeros(k))
    with pytest.raises(BadArgument, match="measure"):
        mfc.sweep(lambda k: k, {"k": [1, 2]}, lambda k: {"a": 1} if k == 1 else 2)
