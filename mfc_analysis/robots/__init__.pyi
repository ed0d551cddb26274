from .catalogue import load as load, names as names, planar_2r as planar_2r, rp as rp, single_joint as single_joint, slider as slider, ur5 as ur5
from .coupling import lacks_armature as lacks_armature, relative_gain as relative_gain
from .limits import Limits as Limits
from .primitives import Primitives as Primitives
from .robot import Payload as Payload, Robot as Robot
