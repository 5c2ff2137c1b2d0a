"""Compiled arithmetic of LIDAR odometry before and after a match: its prior, and the motion that it shows."""

import math
from collections import namedtuple

import numpy as np

from longreach.geometry._kernels import se2_between, se2_compose, se2_exp, se2_log
from longreach.kernels import kernel
from longreach.odometry._dead_reckoning_kernels import add_transformed

PriorSettings = namedtuple("PriorSettings", "position heading motion linear angular speed turn")


@kernel
def predict(settings, pose, variance, keyframe_pose, twist, unknown, growth, by_wheels):
    """Return the arrays (3,) of a `Prior`: the base at a pose (3,) of a variance (3,) moves by a twist (3,).

    unknown [s]: for how long it may have accelerated without the prediction knowing of it. growth [s²]: of the time for
    which nothing was observed. by_wheels: there the prior is off by a part of the way since the keyframe at most.
    """
    expected, sigma, free, astray = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    x, y, t = se2_exp(twist[0], twist[1], twist[2])
    far, turned, square = math.hypot(x, y), abs(t), min(unknown, 1.0) ** 2
    at = settings.position + settings.motion * far + settings.linear * square
    to = settings.heading + settings.motion * turned + 0.1 * far + settings.angular * square
    x, y, t = se2_compose(pose[0], pose[1], pose[2], x, y, t)
    expected[0], expected[1], expected[2] = x, y, t
    x, y, t = se2_between(keyframe_pose[0], keyframe_pose[1], keyframe_pose[2], x, y, t)
    away_at = settings.position + settings.motion * math.hypot(x, y)
    away_to = settings.heading + settings.motion * abs(t)
    for i in range(3):
        deviation, speed, off = (to, settings.turn, away_to) if i == 2 else (at, settings.speed, away_at)
        sigma[i] = math.sqrt(variance[i] + deviation * deviation)
        free[i] = speed * speed * growth
        astray[i] = min(free[i], off * off) if by_wheels else free[i]
    return expected, sigma, free, astray


@kernel
def relate(keyframe_pose, keyframe_noise, pose, covariance, shared, moved, mean, period):
    """Return a match relative to its keyframe: pose (3,), covariance and the shared part of it (3, 3); and the motion.

    keyframe_noise (3, 3): of the keyframe's own match, with the map's error; NaN: `shared` stands for it. The motion
    (2, 3): the last twist, by which the base moved, and the mean of twists; period: over the time that this lasts.
    """
    relative, whole, common, A = np.empty(3), np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    x, y, t = se2_between(keyframe_pose[0], keyframe_pose[1], keyframe_pose[2], pose[0], pose[1], pose[2])
    relative[0], relative[1], relative[2] = x, y, t
    x, y, t = se2_between(x, y, t, 0.0, 0.0, 0.0)
    add_transformed(x, y, t, 1.0, keyframe_noise, A, common)
    unknown = math.isnan(common[0, 0])
    for i in range(3):
        for j in range(3):
            common[i, j] = shared[i, j] if unknown else common[i, j]
            whole[i, j] = covariance[i, j] - shared[i, j] + common[i, j]
    motion, part = np.empty((2, 3)), -math.expm1(-period)
    motion[0, 0], motion[0, 1], motion[0, 2] = se2_log(moved[0], moved[1], moved[2])
    for i in range(3):
        motion[1, i] = mean[i] + part * (motion[0, i] - mean[i])
    return relative, whole, common, motion
