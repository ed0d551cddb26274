"""Sweeps over named grids by joblib, as an xarray with named axes. A point that fails is recorded with its error.

Any joblib backend distributes the points: ``with joblib.parallel_config(backend="dask"): mfc.sweep(...)``. The default (loky) sends
functions by cloudpickle, so closures and lambdas work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mfc_analysis.errors import BadArgument, MfcWarning, require
from mfc_analysis.maths import checks

if TYPE_CHECKING:
    import xarray as xr

ERROR = "error"  #: name of the coordinate with the error message of each point; empty where the point succeeds


class Point(NamedTuple):
    """Result at one point of a sweep."""

    value: Any  #: result of ``measure``; None where it fails
    error: str  #: error message, or empty


def sweep(
    build: Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    measure: Callable[[Any], Any],
    *,
    n_jobs: int | None = None,
    progress: bool = False,
) -> xr.DataArray | xr.Dataset:
    """``measure(build(**point))`` at every point of the grid.

    Args:
        build: keyword parameters -> the argument of ``measure``, usually a ``ClosedLoop``.
        grid: name -> values (numbers or words), one axis each, in this order.
        measure: -> a number or an array (a ``DataArray``; further axes are ``dim_0``, ...), or a mapping of these (a ``Dataset``). Results
            of one name have one shape.
        n_jobs: processes; None: set by ``joblib.parallel_config``, else one. progress: a bar on the terminal.

    Returns:
        NaN where a point fails. The coordinate ``error`` over the axes of the grid holds the error message (empty where the point
        succeeds). A warning gives the number of failed points.

    Raises:
        BadArgument: functions that cannot be called, an empty grid or axis, inconsistent results.
        MissingExtra: xarray is not installed.
    """
    require("sweep")
    axes = _checked(build, grid, measure)
    return _gathered(axes, evaluated(build, axes, measure, n_jobs, progress, "sweep"))


def evaluated(
    build: Callable[..., Any], axes: Mapping[str, Sequence[Any]], measure: Callable[[Any], Any], n_jobs: int | None, progress: bool, title: str
) -> list[Point]:
    """The results of ``sweep`` at all points, the last axis varying fastest, with its warning of those that fail. Raises BadArgument."""
    import joblib
    from joblib.parallel import get_active_backend

    checks.jobs(n_jobs)
    points = [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
    streams = bool(getattr(get_active_backend()[0], "supports_return_generator", False))  # Dask, for example, does not
    parallel = joblib.Parallel(n_jobs=n_jobs, return_as="generator" if streams else "list")
    done: list[Point] = []
    with _bar(progress, len(points), title) as advance:
        found: Iterator[Point] = iter(parallel(joblib.delayed(one_point)(build, measure, p) for p in points))  # pyright: ignore[reportArgumentType, reportAssignmentType]
        for point in found:
            advance()
            done.append(point)
    failed = [i for i, p in enumerate(done) if p.error]
    if failed:
        import warnings

        where = ", ".join(f"{name}={x!r}" for name, x in points[failed[0]].items())
        said = f"{title}: {len(failed)} of {len(done)} points failed; the first at {where}: {done[failed[0]].error}"
        warnings.warn(said, MfcWarning, stacklevel=3)
    return done


def _checked(build: Any, grid: Any, measure: Any) -> dict[str, list[Any]]:
    for name, given in (("build", build), ("measure", measure)):
        if not callable(given):
            raise BadArgument(name, given, "a function")
    if not isinstance(grid, Mapping) or not grid:
        raise BadArgument("grid", grid, "a mapping of names to values, such as {'payload': [0, 1, 2]}")
    axes: dict[str, list[Any]] = {}
    for name, values in grid.items():
        if not isinstance(name, str) or name == ERROR or name.startswith("dim_"):
            raise BadArgument("grid", name, f"names of parameters, other than {ERROR!r} and 'dim_...'")
        if isinstance(values, (str, bytes)) or not isinstance(values, (Iterable, np.ndarray)):
            raise BadArgument(f"grid[{name!r}]", values, "a list of values")
        axes[name] = [x.item() if isinstance(x, np.generic) else x for x in values]
        if not axes[name]:
            raise BadArgument(f"grid[{name!r}]", values, "at least one value")
    return axes


def one_point(build: Callable[..., Any], measure: Callable[[Any], Any], point: Mapping[str, Any]) -> Point:
    """Result or error at one point. A module-level function, so that every backend can send it."""
    try:
        value = measure(build(**point))
        if isinstance(value, Mapping):
            return Point({str(name): np.asarray(x) for name, x in value.items()}, "")
        return Point(np.asarray(value), "")
    except Exception as why:  # user functions: any error they raise is recorded for the point
        return Point(None, f"{type(why).__name__}: {' '.join(str(why).split())}")


@contextmanager
def _bar(progress: bool, total: int, title: str) -> Iterator[Callable[[], None]]:
    if not progress:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    with Progress(TextColumn(title), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=Console(stderr=True)) as bar:
        task = bar.add_task(title, total=total)
        yield lambda: bar.advance(task)


# --- the result ------------------------------------------------------------------------------------------------------


def _gathered(axes: Mapping[str, list[Any]], done: list[Point]) -> xr.DataArray | xr.Dataset:
    import xarray as xr

    shape = tuple(len(values) for values in axes.values())
    errors = np.array([p.error for p in done], dtype=object).reshape(shape)
    coords: dict[str, Any] = {name: _coordinate(values) for name, values in axes.items()}
    coords = {name: (name, values) for name, values in coords.items()}
    coords[ERROR] = (tuple(axes), errors.astype(str))
    values = [p.value for p in done]
    named = next((v for v in values if v is not None), np.array(np.nan))
    if isinstance(named, Mapping):
        several = {name: _block(axes, shape, [None if v is None else _entry(v, name) for v in values], name) for name in named}
        return xr.Dataset(several, coords=coords)
    if any(isinstance(v, Mapping) for v in values):
        raise BadArgument("measure", "a number at one point and a mapping at another", "a function that always returns the same kind")
    dims, data = _block(axes, shape, values, "measure")
    return xr.DataArray(data, dims=dims, coords=coords)


def _entry(value: Any, name: str) -> Any:
    if not isinstance(value, Mapping) or name not in value:
        raise BadArgument("measure", sorted(value) if isinstance(value, Mapping) else "a number", f"a function that returns {name!r} at every point")
    return value[name]


def _block(axes: Mapping[str, list[Any]], shape: tuple[int, ...], values: list[Any], name: str) -> tuple[tuple[str, ...], NDArray[Any]]:
    """All values as one array over the grid axes and their own axes, NaN (or empty) where there is no value."""
    there = [np.asarray(v) for v in values if v is not None]
    inner = there[0].shape if there else ()
    if any(v.shape != inner for v in there):
        raise BadArgument(name, f"results of shapes {sorted({v.shape for v in there})}", "results of one shape")
    kinds = np.result_type(*(v.dtype for v in there)) if there else np.dtype(float)
    holes = len(there) < len(values)
    if holes and kinds.kind in "biu":
        kinds = np.dtype(float)
    fill: Any = np.nan if kinds.kind in "fc" else None if kinds.kind == "O" else "" if kinds.kind == "U" else 0
    out = np.full((len(values), *inner), fill, kinds)
    for i, v in enumerate(values):
        if v is not None:
            out[i] = v
    return (*axes, *(f"dim_{k}" for k in range(len(inner)))), out.reshape(shape + inner)


def _coordinate(values: list[Any]) -> NDArray[Any]:
    """An axis of numbers or words as given; labels of any other values."""
    try:
        out = np.asarray(values)
    except ValueError:
        out = np.empty(0, object)
    if out.ndim == 1 and out.size == len(values) and out.dtype.kind in "biufUS":
        return out
    return np.array([str(x) for x in values])
