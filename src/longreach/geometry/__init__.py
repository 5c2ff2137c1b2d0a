"""Rotations and rigid motions: SO(3), SE(2), SE(3). The only room that knows how they are made."""
