"""Values between the values of rows."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from mfc_analysis.analysis.delay.grid import apart, between, room
from mfc_analysis.analysis.frequency.peak import frequencies_of_interest, thinned


def test_steps_are_divided_into_equal_ones_of_at_most_the_step():
    w = np.array([[0.0, 1.0, 1.0, 4.0], [0.0, 0.1, 0.2, 0.3]])
    more = between(w, np.array([1.0, 1.0]))
    assert_allclose(more, [[2.0, 3.0], [0.3, 0.3]])
    every = np.sort(np.concatenate([w, between(w, np.array([0.3, 0.04]))], axis=1), axis=1)
    assert (np.diff(every, axis=1).max(axis=1) <= np.array([0.3, 0.04]) * (1 + 1e-9)).all()
    assert np.isin(w, every).all()


def test_rows_that_need_no_values_get_none():
    assert between(np.array([[1.0, 2.0]]), np.array([1.0])).shape == (1, 0)


def test_there_is_room_for_the_values_of_each_row():
    empty, column = room(np.array([0, 0, 2]), np.array([[1.0], [2.0], [3.0]]))
    assert_allclose(empty, [[1, 1], [2, 2], [3, 3]])
    assert column.tolist() == [0, 1, 0]


def test_of_poles_that_are_alike_one_is_left():
    poles = np.array([[-1.0, -1.02, -1 + 50j, -1 - 50j, np.nan, -0.99], [-1e-6 + 3j, -1e-6 + 3.001j, -2.0, -2.0, -2.0, -2.0]], complex)
    found = apart(poles)
    assert found.shape == (2, 3)
    assert np.isin(found, poles).all()
    assert_allclose(np.sort(found[0].imag), [-50, 0, 50])
    assert_allclose(np.sort(found[1].imag), [0, 3, 3.001])


def test_real_poles_that_are_below_the_axis_by_rounding_are_not_taken_for_lower_ones():
    """Computed twice, of two roundings: without an upper pole there is no distance from the next one (``thinned``)."""
    poles = np.array([[-0.56 - 3e-16j, -0.56 + 2e-16j, -7.4 - 1e-14j, -7.4 - 2e-14j, -3 - 0.3j, -3 + 0.3j]])
    found = apart(poles)
    assert (found.imag >= 0).all()
    assert_allclose(np.sort(found[0].real), [-7.4, -3, -0.56])
    assert np.isfinite(thinned(frequencies_of_interest(found, 0.01), found)).all()


def test_where_there_is_no_pole_there_is_nothing_to_choose():
    assert apart(np.zeros((2, 3), complex)).shape == (2, 1)
