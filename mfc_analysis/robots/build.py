"""From a Pinocchio model to one that can be analysed: locked joints, tool frame, joint order, and checks."""

from __future__ import annotations

import tempfile
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from mfc_analysis.errors import BadArgument, BadRobot, MfcWarning, UnknownName
from mfc_analysis.maths import checks
from mfc_analysis.maths.arrays import Array, Ints

Locked = str | Sequence[str] | Mapping[str, float] | None

_USUAL_TOOL = "tool0"  # ROS-Industrial's name of the flange, preferred among several leaves of a chain
_ROUNDING = 1e-3  # of the largest moment of inertia, what printed numbers of three digits may lack
_EMPTY = 1e-12  # fraction of a mass or an inertia that is rounding error of a subtraction
_SINGULAR = 1e-12  # smallest eigenvalue of the mass matrix scaled to a unit diagonal, below which it counts as singular


def movable_joints(model: pin.Model) -> tuple[str, ...]:
    """Names of the joints that move, in Pinocchio's order. Joint i of the model is number i - 1: Pinocchio's first is the world, "universe"."""
    return tuple(model.names[1:])


def model_of_mjcf(text: str, name: str) -> pin.Model:
    """Pinocchio's model of an MJCF that has been checked; it reads files only. Raises ``BadRobot``."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.xml"
        path.write_text(text, encoding="utf-8")
        try:
            model = pin.buildModelFromMJCF(str(path))
        except (ValueError, RuntimeError, IndexError) as why:
            raise BadRobot("Pinocchio cannot build a model from the bodies and joints of this MJCF; MuJoCo's own messages may say why") from why
    model.name = name
    return model


def lock(model: pin.Model, locked: Locked) -> pin.Model:
    """A copy of the model with these joints locked: names at 0, or ``{name: value}`` [rad or m].

    Raises ``UnknownName`` for an unknown joint, ``BadArgument`` for a value that is not a finite number.
    """
    if locked is None:
        return pin.Model(model)
    if isinstance(locked, str):
        locked = [locked]
    values = dict(locked) if isinstance(locked, Mapping) else dict.fromkeys(checks.names("locked", locked, movable_joints(model)), 0.0)
    q = pin.neutral(model)
    ids = []
    for name, value in values.items():
        if name not in movable_joints(model):
            raise UnknownName("locked", name, movable_joints(model))
        ids.append(1 + movable_joints(model).index(name))
        joint = model.joints[ids[-1]]
        if joint.nv != 1:
            raise BadRobot(f"joint {name!r} has {joint.nv} degrees of freedom: only joints with one can be locked")
        angle = checks.number(f"locked[{name!r}]", value)
        q[joint.idx_q : joint.idx_q + joint.nq] = angle if joint.nq == 1 else (np.cos(angle), np.sin(angle))
    return _reduced(model, ids, q) if ids else pin.Model(model)


def _reduced(model: pin.Model, ids: list[int], q: Array) -> pin.Model:
    """Pinocchio's reduced model. It rejects a name that two frames share, so all have names of their own meanwhile."""
    model, real = pin.Model(model), {}
    for i, frame in enumerate(list(model.frames)[1:], start=1):
        given = f"joint {frame.parentJoint}" if frame.type == pin.FrameType.JOINT else f"frame {i}"
        real[given], model.frames[i].name = frame.name, given
    for i, name in enumerate(movable_joints(model), start=1):
        real[f"joint {i}"], model.names[i] = name, f"joint {i}"
    reduced = pin.buildReducedModel(model, ids, q)
    for i, name in enumerate(reduced.names):
        reduced.names[i] = real.get(name, name)
    for i, frame in enumerate(reduced.frames):
        reduced.frames[i].name = real.get(frame.name, frame.name)
    return reduced


def check_joints(model: pin.Model, mimic: Iterable[str] = ()) -> None:
    """Raises ``BadRobot`` unless there is a joint, and each has a name of its own, one degree of freedom, and mimics no other."""
    if model.njoints < 2:
        raise BadRobot(f"robot {model.name!r} has no joint that moves")
    twice = [name for name, count in Counter(movable_joints(model)).items() if count > 1]
    if twice:
        raise BadRobot(f"robot {model.name!r} has more than one joint named {twice[0]!r}")
    for name, joint in zip(model.names[1:], list(model.joints)[1:], strict=True):
        kind = joint.shortname().removeprefix("JointModel")
        if "Mimic" in kind:
            raise BadRobot(f"joint {name!r} mimics another one: lock it, with locked=[{name!r}]")
        if joint.nv != 1:
            raise BadRobot(
                f"joint {name!r} ({kind}) has {joint.nv} degrees of freedom: "
                "this library takes fixed bases and joints with one; replace it by such joints, or remove it"
            )
    still = [name for name in mimic if name in movable_joints(model)]
    if still:
        raise BadRobot(f"joint {still[0]!r} mimics another one, which is not supported: lock it, with locked={still!r}")


def check_inertias(model: pin.Model, inertias: Mapping[str, Array]) -> None:
    """Raises ``BadRobot`` where the inertia of a link that moves has a negative principal moment, beyond rounding.

    Warns (``MfcWarning``) where one principal moment is larger than the sum of the others, which no body has; some published URDFs do.

    Args:
        inertias: (3, 3) [kg m^2] of each link, by name. A link that no joint moves is not checked: it has no effect.
    """
    moving = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY and frame.parentJoint > 0}
    for link in (name for name in inertias if name in moving):
        moments = np.linalg.eigvalsh(inertias[link])
        rounding = _ROUNDING * float(np.abs(moments).max())
        if moments[0] < -rounding:
            raise BadRobot(f"link {link!r}: its inertia has a negative principal moment, {moments[0]:.3g} kg m^2, which is not possible")
        if moments[2] > moments[0] + moments[1] + rounding:
            said = ", ".join(f"{moment:.3g}" for moment in moments)
            text = f"link {link!r}: its principal moments of inertia {said} kg m^2 are not possible: the largest is above the sum of the others"
            warnings.warn(text, MfcWarning, stacklevel=4)


def check_masses(model: pin.Model) -> None:
    """Raises ``BadRobot``, which names the joint, where the mass matrix is singular, not positive or not finite."""
    for name, body in zip(model.names, model.inertias, strict=True):
        if not (np.isfinite(body.mass) and np.isfinite(body.inertia).all() and np.isfinite(body.lever).all()):
            raise BadRobot(f"the body moved by joint {name!r} has an inertia that is not finite")
        if body.mass < 0:
            raise BadRobot(f"the body moved by joint {name!r} has a negative mass, {body.mass:g} kg")
    data = model.createData()
    rng = np.random.default_rng(9)
    best, worst, diagonal = -np.inf, np.inf, np.full(model.nv, -np.inf)
    where = places(model)
    for _ in range(4):  # a valid mass matrix may be singular at one configuration, not at four
        M = upper_to_full(pin.crba(model, data, configuration(where, rng.uniform(-2.0, 2.0, model.nv))))
        if not np.isfinite(M).all():
            raise BadRobot(f"the mass matrix of {model.name!r} is not finite: a mass, an inertia or a length is too large")
        diagonal = np.maximum(diagonal, np.diag(M))
        scale = np.sqrt(np.maximum(np.diag(M), 1e-300))
        smallest = float(np.linalg.eigvalsh(M / scale[:, None] / scale)[0])
        best, worst = max(best, smallest), min(worst, smallest)
    empty = [name for name, m in zip(movable_joints(model), diagonal, strict=True) if m <= 1e-12]
    if empty:
        raise BadRobot(
            f"joint {empty[0]!r} moves no mass (its effective inertia is {float(diagonal.min()):.3g}): give its link mass and inertia, or lock it"
        )
    if best < _SINGULAR or worst < -_SINGULAR:
        raise BadRobot(f"the mass matrix of {model.name!r} is not positive definite: a link has zero or negative inertia about its axis of motion")


def frame_id(model: pin.Model, name: str) -> int:
    """Id of the frame ``name``; where a link and a joint share it, the link. Raises ``UnknownName``."""
    for kind in (pin.FrameType.BODY, pin.FrameType.OP_FRAME, pin.FrameType.FIXED_JOINT, pin.FrameType.SENSOR, pin.FrameType.JOINT):
        for i, frame in enumerate(model.frames):
            if frame.name == name and frame.type == kind and i > 0:
                return i
    raise UnknownName("tool", name, dict.fromkeys(f.name for f in list(model.frames)[1:]))


def default_tool(whole: pin.Model, model: pin.Model) -> str:
    """The last link of the chain: the only leaf that every joint moves, or ``tool0`` among several.

    The leaves are those of the ``whole`` model, before joints are locked (Pinocchio's reduced model does not keep the parents of frames).
    Raises ``BadArgument``, which lists the leaves, where the choice is ambiguous.
    """
    carrying = {f.parentFrame for i, f in enumerate(whole.frames) if f.parentFrame != i and f.type != pin.FrameType.OP_FRAME}
    last = {f.name for i, f in enumerate(whole.frames) if i > 0 and f.type == pin.FrameType.BODY and i not in carrying}
    leaves = [f for f in model.frames if f.type == pin.FrameType.BODY and f.name in last and f.parentJoint > 0]
    depth = {f.name: len(model.supports[f.parentJoint]) - 1 for f in leaves}
    full = [f.name for f in leaves if depth[f.name] == model.njoints - 1]
    if len(full) == 1:
        return str(full[0])
    if _USUAL_TOOL in full:
        return _USUAL_TOOL
    if not leaves and len(model.supports[model.njoints - 1]) == model.njoints:  # a bare chain of joints
        return str(model.names[-1])
    known = ", ".join(repr(n) for n in (full or depth)) or "none"
    raise BadArgument("tool", None, f"the name of a link or frame: the last link of {model.name!r} is ambiguous ({known})")


def joint_order(model: pin.Model, joints: Sequence[str] | None) -> NDArray[np.intp]:
    """(n,) Pinocchio's velocity index of each of the user's joints; ``joints`` must name each movable joint once."""
    names = movable_joints(model)
    index = {name: joint.idx_v for name, joint in zip(names, list(model.joints)[1:], strict=True)}
    if joints is None:
        joints = sorted(names, key=index.__getitem__)
    joints = checks.names("joints", joints, names)
    if len(set(joints)) != len(joints) or len(joints) != len(names):
        missing = [name for name in names if name not in joints]
        hint = f"; {missing!r} are missing: add them, or lock them with locked=" if missing else "; one is named twice"
        raise BadArgument("joints", list(joints), f"every movable joint once{hint}")
    order = np.array([index[name] for name in joints], dtype=np.intp)
    order.setflags(write=False)
    return order


def body(mass: float, com: Array, inertia: Array) -> pin.Inertia:
    """Pinocchio's inertia of a body, about the com. Its constructor rejects an eigenvalue of -1e-18, which is rounding error."""
    out = pin.Inertia.Zero()
    out.mass, out.lever, out.inertia = mass, np.array(com, float), np.array(inertia, float)
    return out


def reduced(whole: pin.Inertia, part: Array) -> pin.Inertia:
    """The inertia without the spatial inertia ``part`` (6, 6) of a body that is in it; both about the same origin."""
    rest = whole.matrix() - part
    mass = float(rest[0, 0])
    if mass <= _EMPTY * whole.mass:
        return body(0.0, np.zeros(3), np.where(np.abs(rest) > _EMPTY * np.abs(whole.matrix()).max(), rest, 0.0)[3:, 3:])
    C = rest[3:, :3] / mass  # [com]
    return body(mass, np.array([C[2, 1], C[0, 2], C[1, 0]]), rest[3:, 3:] + mass * C @ C)


def rotational_inertia(inertia: ArrayLike) -> Array:
    """(3, 3) from a scalar or a symmetric positive matrix [kg m^2]; ``BadArgument`` otherwise."""
    I = checks.array("inertia", inertia)
    takes = "a scalar >= 0 or a symmetric positive (3, 3) matrix [kg m^2], about the com in tool axes"
    if I.shape not in ((), (3, 3)):
        raise BadArgument("inertia", f"shape {I.shape}", takes)
    full = np.array(I * np.eye(3) if I.ndim == 0 else I)
    scale = float(np.abs(full).max())
    if not np.allclose(full, full.T, rtol=0, atol=1e-9 * scale) or np.linalg.eigvalsh(full)[0] < -1e-9 * scale:
        raise BadArgument("inertia", inertia, takes)
    full = 0.5 * full + 0.5 * full.T
    full.setflags(write=False)
    return full


def upper_to_full(M: Array) -> Array:
    """The symmetric matrix from the upper triangle that Pinocchio fills."""
    return np.asarray(np.triu(M) + np.triu(M, 1).T)


def places(model: pin.Model) -> Ints:
    """(nq,) what Pinocchio's configuration is made of: places in the angles (nv,), their cosines and their sines, one after the other."""
    out = np.empty(model.nq, int)
    for j in list(model.joints)[1:]:
        out[j.idx_q : j.idx_q + j.nq] = j.idx_v if j.nq == 1 else (model.nv + j.idx_v, 2 * model.nv + j.idx_v)
    return out


def configuration(where: Ints, angles: Array) -> Array:
    """(..., nq) Pinocchio's configuration at angles (..., nv) in its own order: (cos, sin) for a continuous joint. ``where``: its ``places``."""
    return np.concatenate([angles, np.cos(angles), np.sin(angles)], axis=-1)[..., where]
