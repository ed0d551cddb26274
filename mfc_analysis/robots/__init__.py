"""Robots: the wrapper of Pinocchio and the catalogue. The only room that imports Pinocchio."""

from mfc_analysis.robots.catalogue import load, names, planar_2r, rp, single_joint, slider, ur5
from mfc_analysis.robots.robot import Limits, Payload, Robot

__all__ = ["Limits", "Payload", "Robot", "load", "names", "planar_2r", "rp", "single_joint", "slider", "ur5"]
