"""Units that users think in."""

import pytest

from mfc_analysis.errors import BadArgument
from mfc_analysis.units import hertz


def test_hertz_is_two_pi() -> None:
    assert hertz(4) == pytest.approx(25.132741228718345, rel=1e-15)
    with pytest.raises(BadArgument, match="f: got -1"):
        hertz(-1)
