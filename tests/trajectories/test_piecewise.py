from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.interpolate import make_interp_spline

from mfc_analysis.trajectories.piecewise import Piecewise


def test_hermite_pieces_have_the_values_they_were_given():
    rng = np.random.default_rng(0)
    t = np.array([0.0, 0.3, 1.0, 1.2])
    q, v, a = rng.normal(size=(3, 4, 2))
    path = Piecewise.hermite(t, q, v, a)
    for k, x in enumerate(t):
        for side in (-1e-12, 1e-12):
            if t[0] < x + side < t[-1]:
                for found, given in zip(path.at(np.array(x + side)), (q, v, a), strict=True):
                    assert_allclose(found, given[k], atol=1e-8)


def test_hermite_pieces_reproduce_a_quintic():
    p = np.polynomial.Polynomial([1.0, -2, 0.5, 3, -1, 0.7])
    t = np.array([0.0, 0.4, 1.5])
    path = Piecewise.hermite(t, *(f(t)[:, None] for f in (p, p.deriv(), p.deriv(2))))
    x = np.linspace(0, 1.5, 11)[1:-1]
    for found, f in zip(path.at(x), (p, p.deriv(), p.deriv(2)), strict=True):
        assert_allclose(found[:, 0], f(x), atol=1e-11)


def test_the_spline_is_scipys():
    rng = np.random.default_rng(1)
    t, q = np.sort(rng.uniform(0, 5, 8)), rng.normal(size=(8, 3))
    zero = np.zeros(3)
    scipys = make_interp_spline(t, q, k=5, bc_type=([(1, zero), (2, zero)],) * 2)
    x = np.linspace(t[0], t[-1], 33)[1:-1]
    for nu, found in enumerate(Piecewise.spline(t, q).at(x)):
        assert_allclose(found, scipys(x, nu=nu), atol=1e-7 * np.abs(scipys(x, nu=nu)).max())
