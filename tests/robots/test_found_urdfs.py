"""URDFs as they are found: each gives the dynamics of its clean form, or an error that names link or joint and attribute; stderr stays empty."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mfc_analysis.errors import BadRobot
from mfc_analysis.maths.se3 import exp6
from mfc_analysis.robots.catalogue import ur5_urdf
from mfc_analysis.robots.robot import Robot
from tests.robots.arms import CONTINUOUS, TWO

# Six joints with oblique axes, turned frames and full inertias, as numbers; the text is made from them, and so are M and g.
_RNG = np.random.default_rng(75)
KINDS = ("continuous", "revolute", "revolute", "prismatic", "continuous", "revolute")
ORIGINS, RPYS, AXES, COMS = (_RNG.uniform(-0.7, 0.7, (6, 3)).round(3) for _ in range(4))
MASSES = _RNG.uniform(0.5, 5.0, 6).round(2)
_SPREAD = _RNG.uniform(-0.2, 0.2, (6, 8, 3))  # eight points, whose inertia some body has
INERTIAS = np.array([(np.trace(S) * np.eye(3) - S).round(6) for S in (np.einsum("ki,kj->ij", p, p) for p in _SPREAD)])


def _text(values: np.ndarray) -> str:
    return " ".join(map(repr, map(float, np.atleast_1d(values))))


def six_joints() -> str:
    parts = ['<link name="l0"/>']
    for i in range(6):
        I = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), INERTIAS[i][np.triu_indices(3)], strict=True))
        inertia = " ".join(f'{name}="{float(value)!r}"' for name, value in I.items())
        parts.append(
            f'<link name="l{i + 1}"><inertial><origin xyz="{_text(COMS[i])}" rpy="0 0 0"/><mass value="{_text(MASSES[i])}"/>'
            f"<inertia {inertia}/></inertial></link>"
        )
        parts.append(
            f'<joint name="j{i + 1}" type="{KINDS[i]}"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="{_text(AXES[i])}"/>'
            f'<origin xyz="{_text(ORIGINS[i])}" rpy="{_text(RPYS[i])}"/><limit lower="-2" upper="2" effort="9" velocity="3"/>'
            '<dynamics damping="0.7" friction="0.2"/></joint>'
        )
    return '<robot name="six">' + "".join(parts) + "</robot>"


BASES = {"two": TWO, "continuous": CONTINUOUS, "six": six_joints(), "ur5": ur5_urdf()}
TOOLS = {"ur5": "tool0"}  # the others end in one link
CLEAN = {name: Robot.from_urdf(text, tool=TOOLS.get(name)) for name, text in BASES.items()}


def dynamics_of_six(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M and g of the six joints: each body's kinetic and potential energy, from its Jacobian at the com, in world axes."""
    M, g = np.zeros((6, 6)), np.zeros(6)
    R, p, joints = np.eye(3), np.zeros(3), []
    for i in range(6):
        roll, pitch, yaw = (exp6(np.r_[0, 0, 0, angle * axis])[:3, :3] for angle, axis in zip(RPYS[i], np.eye(3), strict=True))
        R, p = R @ yaw @ pitch @ roll, p + R @ ORIGINS[i]
        u = AXES[i] / np.linalg.norm(AXES[i])
        joints.append((KINDS[i], R @ u, p))
        if KINDS[i] == "prismatic":
            p = p + q[i] * R @ u
        else:
            R = R @ exp6(np.r_[0, 0, 0, q[i] * u])[:3, :3]
        com = p + R @ COMS[i]
        Jv, Jw = np.zeros((3, 6)), np.zeros((3, 6))
        for j, (kind, z, at) in enumerate(joints):
            Jv[:, j], Jw[:, j] = (z, 0 * z) if kind == "prismatic" else (np.cross(z, com - at), z)
        M += MASSES[i] * Jv.T @ Jv + Jw.T @ R @ INERTIAS[i] @ R.T @ Jw
        g += MASSES[i] * 9.81 * Jv[2]
    return M, g


def test_the_clean_arm_of_six_joints_has_the_dynamics_of_its_numbers():
    for q in np.random.default_rng(1).uniform(-2, 2, (5, 6)):
        M, g = dynamics_of_six(q)
        assert_allclose(CLEAN["six"].mass(q), M, rtol=1e-10, atol=1e-12)
        assert_allclose(CLEAN["six"].gravity(q), g, rtol=1e-10, atol=1e-12)


# --- the same arm in other words ----------------------------------------------------------------------------------------------

NUMBER = {  # how to find an attribute that is a number
    "mass value": r'(<mass value=")([^"]*)',
    "origin xyz": r'(<origin xyz=")([^"]*)',
    "origin rpy": r'(rpy=")([^"]*)',
    "axis xyz": r'(<axis xyz=")([^"]*)',
    "limit lower": r'(lower=")([^"]*)',
    "limit upper": r'(upper=")([^"]*)',
    "limit effort": r'(effort=")([^"]*)',
    "limit velocity": r'(velocity=")([^"]*)',
    "dynamics damping": r'(damping=")([^"]*)',
    "dynamics friction": r'(friction=")([^"]*)',
    **{f"inertia {name}": rf'({name}=")([^"]*)' for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")},
}
SPELLINGS: dict[str, Callable[[str], str]] = {
    "a blank before": lambda x: " " + x,
    "a blank after": lambda x: x + " ",
    "a tab after": lambda x: x + "\t",
    "a line break after": lambda x: x + "\n",
    "an escaped line break": lambda x: x + "&#10;",
    "an escaped blank before": lambda x: "&#32;" + x,
    "an exponent": lambda x: " ".join(f"{float(v)!r}e0" for v in x.split()),
    "plus signs": lambda x: " ".join(v if v.startswith("-") else "+" + v for v in x.split()),
    "wide gaps": lambda x: x.replace(" ", " \t\n  "),
    "a bare point": lambda x: " ".join(re.sub(r"^(-?)0\.", r"\1.", v) if "." in v else v + "." for v in x.split()),
}


def spelt(pattern: str, spell: Callable[[str], str]) -> Callable[[str], str]:
    return lambda text: re.sub(pattern, lambda found: found[1] + spell(found[2]), text)


def every_number(spell: Callable[[str], str]) -> Callable[[str], str]:
    return spelt("(" + "|".join(found.partition(")")[0].lstrip("(") for found in NUMBER.values()) + r')([^"]*)', spell)


def renamed(kind: str, which: int, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        old = re.findall(rf'<{kind} name="([^"]*)"', text)[which]
        owner = r'(<link name="|(?:parent|child) link=")' if kind == "link" else r'(<joint name=")'
        return re.sub(rf'{owner}{re.escape(old)}"', rf'\g<1>{new}"', text)

    return change


def joints_named_as_links(text: str) -> str:
    return re.sub(r'<joint name="[^"]*"(.*?)<child link="([^"]*)"', r'<joint name="\2"\1<child link="\2"', text)


def every_axis_times(factor: str) -> Callable[[str], str]:
    return spelt(NUMBER["axis xyz"], lambda x: " ".join(repr(float(v) * float(factor)) for v in x.split()))


def continuous_with(limit: str) -> Callable[[str], str]:
    return lambda text: re.sub(r'(type="continuous".*?)<limit[^>]*>', rf"\1{limit}", text)


NAMES = (
    "universe",
    "root_joint",
    "base_link ",
    "  ",
    "a&#10;b",
    "gr\u00f6\u00dfe \u6f22\u5b57",
    "&lt;a&gt; &amp; &quot;b&quot;",
    "it's",
    "1",
    "arm",
)
SAME: dict[str, Callable[[str], str]] = {
    **{f"every number with {how}": every_number(spell) for how, spell in SPELLINGS.items()},
    **{
        f"{kind} {which} named {new!r}": renamed(kind, which, new)
        for new in NAMES
        for kind, which in (("link", 0), ("link", 1), ("joint", 0), ("joint", 1))
    },
    "every joint is named as its link": joints_named_as_links,
    **{f"every axis times {factor}": every_axis_times(factor) for factor in ("2", "0.1", "1e-200", "1e200")},
    "a default namespace": lambda x: x.replace("<robot ", '<robot xmlns="http://www.ros.org" '),
    "a namespace with a prefix": lambda x: re.sub(r"<(/?)(\w)", r"<\1u:\2", x).replace("<u:robot ", '<u:robot xmlns:u="urn:urdf" '),
    "other namespaces beside": lambda x: x.replace("<link ", '<s:plugin xmlns:s="urn:s"><s:link/></s:plugin><link ', 1),
    "comments and blank lines": lambda x: x.replace("><", "><!-- 1 < 2 -->\n\n\t<"),
    "a byte order mark": lambda x: "\ufeff" + x,
    "a declared encoding that text no longer has": lambda x: f'<?xml version="1.0" encoding="utf-16"?>{x}',
    "a document type": lambda x: f'<!DOCTYPE robot [<!ENTITY zero "0">]>{x}'.replace('ixy="0"', 'ixy="&zero;"'),
    "an empty <dynamics/>": lambda x: re.sub(r"<dynamics[^>]*/>", "", x).replace("</joint>", "<dynamics/></joint>"),
    "a velocity limit alone": continuous_with('<limit velocity="3"/>'),
    "an effort limit alone": continuous_with('<limit effort="9 "/>'),
    "an empty limit": continuous_with("<limit/>"),
    "no limit": continuous_with(""),
    "a new version": lambda x: x.replace("<robot ", '<robot version="7.0" '),
    "no name": lambda x: re.sub(r'<robot name="\w*"', "<robot", x),
    "unknown attributes": lambda x: (
        x.replace("<limit ", '<limit jerk="x" ').replace("<dynamics ", '<dynamics k="y" ').replace("<link ", '<link type="z" ')
    ),
    "inertia before mass": lambda x: re.sub(r"<inertial>(.*?)(<inertia [^>]*/>)</inertial>", r"<inertial>\2\1</inertial>", x),
}
POSES = {name: np.random.default_rng(2).uniform(-1.5, 1.5, (3, robot.n)) for name, robot in CLEAN.items()}
WANTED = {name: (robot.mass(POSES[name]), robot.gravity(POSES[name])) for name, robot in CLEAN.items()}


def assert_same(name: str, found: Robot) -> None:
    M, g = WANTED[name]
    assert_allclose(found.mass(POSES[name]), M, rtol=1e-12, atol=1e-14 * np.abs(M).max())
    assert_allclose(found.gravity(POSES[name]), g, rtol=1e-12, atol=1e-14 * max(1.0, np.abs(g).max()))


@pytest.mark.parametrize("change", SAME)
def test_the_same_arm_in_other_words_has_the_same_dynamics(change, capfd):
    texts = {name: SAME[change](text) for name, text in BASES.items()}
    assert texts != BASES
    for name, text in texts.items():
        assert_same(name, Robot.from_urdf(text, tool=TOOLS.get(name)))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_called_universe_is_found_by_its_name(joint):
    text = renamed("joint", joint, "universe")(renamed("link", 1, "universe")(BASES["two"]))
    names = ["universe", "j2"] if joint == 0 else ["j1", "universe"]
    found = Robot.from_urdf(text, tool="two")
    assert found.joint_names == tuple(names)
    assert_same("two", found)
    turned = Robot.from_urdf(text, joints=names[::-1])
    assert_allclose(turned.mass(POSES["two"][0, ::-1]), WANTED["two"][0][0][::-1, ::-1])
    for which, old in enumerate(("j1", "j2")):
        locked = Robot.from_urdf(text, tool="two", locked={names[which]: 0.3})
        assert locked.joint_names == (names[1 - which],)
        assert_allclose(locked.mass([0.2]), Robot.from_urdf(TWO, tool="two", locked={old: 0.3}).mass([0.2]), rtol=1e-13)
    assert Robot.from_urdf(text, tool="universe", locked=["universe" if joint else "j2"]).tool == "universe"


ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "iso-8859-1", "windows-1252", "us-ascii", "shift_jis")


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_file_is_read_in_the_encoding_that_it_declares(encoding, tmp_path, capfd):
    for name, text in BASES.items():
        path = tmp_path / "arm.urdf"
        comment = {"us-ascii": "", "shift_jis": "<!-- \u6f22 -->"}.get(encoding, "<!-- \u00e4 -->")
        path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>{comment}\n{text}'.encode(encoding))
        assert_same(name, Robot.from_urdf(path, tool=TOOLS.get(name)))
    assert capfd.readouterr() == ("", "")


def test_a_name_survives_its_encoding(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_bytes(('<?xml version="1.0" encoding="latin-1"?>' + renamed("joint", 0, "Gelenk \u00e4")(TWO)).encode("latin-1"))
    assert Robot.from_urdf(path).joint_names == ("Gelenk \u00e4", "j2")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (f"<!-- \u00e4 -->{TWO}".encode("latin-1"), "not text in the encoding utf-8, and declares no other"),
        (f'<?xml version="1.0" encoding="utf-8"?><!-- \u00e4 -->{TWO}'.encode("latin-1"), "encoding utf-8, which it declares"),
        (f'<?xml version="1.0" encoding="utf-16"?>{TWO}'.encode(), "encoding utf-16, which it declares"),
        (f'<?xml version="1.0" encoding="klingon"?>{TWO}'.encode(), "encoding klingon, which it declares"),
        (f'<?xml version="1.0" encoding="hex"?>{TWO}'.encode(), "encoding hex, which it declares"),
        (TWO.encode("utf-16")[:-1], "encoding utf-16, as its first bytes say"),
    ],
)
def test_a_file_that_is_not_in_its_encoding_is_refused_by_encoding(content, says, tmp_path, capfd):
    path = tmp_path / "arm.urdf"
    path.write_bytes(content)
    with pytest.raises(BadRobot, match=says):
        Robot.from_urdf(path)
    assert capfd.readouterr() == ("", "")


# --- errors that name the part ------------------------------------------------------------------------------------------------

WORDS = (
    "2_0",
    "\uff12",
    "1,5",
    "nan",
    "inf",
    "-inf",
    "0x10",
    "1e400",
    "1d3",
    "2 0",
    "",
    "2\u00a0",
    "\u22122",
    "1.5.",
    "${m}",
    "2;",
    "1e",
    "true",
    "2\u3000",
    ".",
)
NEGATIVE = ("mass value", "limit effort", "limit velocity", "dynamics damping", "dynamics friction")


def spoilt(text: str, pattern: str, spell: Callable[[str], str]) -> tuple[str, str]:
    """The text with the last such attribute changed, and the name of its link or joint."""
    found = list(re.finditer(pattern, text))[-1]
    owner = re.findall(r'<(link|joint) name="([^"]*)"', text[: found.start()])[-1]
    return text[: found.start(2)] + spell(found[2]) + text[found.end(2) :], f"{owner[0]} {owner[1]!r}"


@pytest.mark.parametrize("attribute", NUMBER)
def test_what_is_no_number_is_refused_by_part_and_attribute(attribute, capfd):
    for word in WORDS:
        for spell in (lambda x, w=word: w, lambda x, w=word: " ".join([*x.split()[:-1], w])):
            changed, owner = spoilt(BASES["six"], NUMBER[attribute], spell)
            with pytest.raises(BadRobot) as info:
                Robot.from_urdf(changed)
            assert str(info.value).startswith(f"{owner}: {attribute}=") and "finite number" in str(info.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("attribute", NEGATIVE)
def test_what_cannot_be_negative_is_refused_by_part_and_attribute(attribute, capfd):
    for text in BASES.values():
        if re.search(NUMBER[attribute], text):
            changed, owner = spoilt(text, NUMBER[attribute], lambda x: f"-{x} ")
            name = "mass" if attribute == "mass value" else attribute.split()[1]
            with pytest.raises(BadRobot, match=f"^{re.escape(owner)}: its {name} -.* is negative$"):
                Robot.from_urdf(changed)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("limit", ['lower="2" upper="-2"', 'lower="1"', 'upper="-1e-9"', 'lower="-1" upper="-2"'])
def test_a_reversed_range_is_refused_by_joint_unless_it_means_nothing(limit, capfd):
    with pytest.raises(BadRobot, match=r"^joint 'j2': its limit lower=.* is above upper="):
        Robot.from_urdf(BASES["two"][::-1].replace('"5.1"=reppu "2-"=rewol', limit[::-1], 1)[::-1])
    found = Robot.from_urdf(re.sub(r'(type="continuous".*?)lower="-2" upper="2"', rf"\1{limit}", BASES["six"]), tool="l6")
    assert np.isinf(found.limits.position[[0, 4]]).all()
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("part", ["inertial", "mass", "inertia", "origin", "axis", "limit", "dynamics", "parent", "child"])
def test_a_part_that_is_there_twice_is_refused_by_link_or_joint(part, capfd):
    first = re.search(rf"<{part}\b[^>]*/>|<{part}>.*?</{part}>", BASES["six"])[0]
    with pytest.raises(BadRobot, match=f"^(link 'l1'|joint 'j1') has more than one <{part}>$"):
        Robot.from_urdf(BASES["six"].replace(first, first + first, 1))
    assert capfd.readouterr() == ("", "")


def test_what_urdfdom_would_take_without_a_word_is_refused(capfd):
    with pytest.raises(BadRobot, match="joint 'j1': <axis> has no xyz"):  # its axis would be zero
        Robot.from_urdf(re.sub(r"<axis[^>]*>", "<axis/>", BASES["six"], count=1))
    with pytest.raises(BadRobot, match="link 'l1': its <origin> has quat_xyzw, which is not read"):
        Robot.from_urdf(BASES["six"].replace('rpy="0 0 0"', 'quat_xyzw="0 0 0 1"'))
    assert capfd.readouterr() == ("", "")
