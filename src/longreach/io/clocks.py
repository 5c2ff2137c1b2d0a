"""Stamps of several topics put on one clock: that of most of them, held against the times of recording.

The times of recording are those of one computer, in the order of arrival. A stamp is older than them by what a message
needs on its way, which changes a little; a clock of another origin, or one that is set, differs from them by a step.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

Clock = Literal["header", "record"]

_SINCE_1970 = 1e8  # [s]; a clock that is beyond this counts from 1970
# What no way takes, so that the clocks must differ [s]: a message of the future, and one that is older than any queue.
_AHEAD, _BEHIND = 0.1, 10.0
_LATE = 0.5  # [s] on the way that are worth a remark
_SET = 0.3  # [s] at least by which a clock is set at once; queues of a busy computer do not stay that long
_LASTING = 10  # messages on each side of a step that have to agree
_SAME = 0.1  # [s] within which steps of several topics are one
_OUTLIER = 0.03  # [s] that a message's way may differ from the usual one
_MANY_EQUAL = 0.05  # share of stamps equal to the one before, from which a clock is coarse and not a message sent twice


class Stamped(NamedTuple):
    """One topic's stamps (n,) of the headers and times (n,) of recording [s], in the order of recording."""

    topic: str
    header: Float[np.ndarray, " n"]
    received: Float[np.ndarray, " n"]


def on_one_clock(
    topics: Mapping[str, Stamped], clock: Clock = "header"
) -> tuple[dict[str, Float[np.ndarray, " n"]], list[str]]:
    """Return the stamps (n,) [s] of each topic on one clock, and what had to be done for it, a sentence each.

    What stays: stamps that run backwards here and there, which are the reader's to repair.
    """
    if clock == "record":
        return {role: one.received for role, one in topics.items()}, []
    stamps, remarks = {}, list[str]()
    for role, one in topics.items():
        header, said = _set(one)
        stamps[role] = header
        remarks += said
    timed = {role: one for role, one in topics.items() if len(one.header) and _counts(one.received)}
    remarks += _moved_back(timed, stamps)
    remarks += _joined(timed, stamps)
    for role, one in topics.items():
        stamps[role], said = _spread(one, stamps[role], role in timed)
        remarks += said
        if role in timed:
            stamps[role], said = _steady(one, stamps[role])
            remarks += said
    return stamps, remarks


def _counts(received: np.ndarray) -> bool:
    """Whether times of recording are more than one value written for all."""
    return bool(received[0] > 0.0 and (len(received) < 2 or received[-1] > received[0]))


def _set(one: Stamped) -> tuple[np.ndarray, list[str]]:
    """Return the headers' stamps, with the time of recording where they have none."""
    header, received = one.header, one.received
    if not len(header):
        return header, []
    unset = (header == 0) & ((header.max() == 0) | (header.max() > _SINCE_1970)) & (received > 0)
    if not unset.any():
        return header, []
    said = f"{unset.sum()} messages of {one.topic} have no stamp; the time of recording is taken."
    return np.where(unset, received, header), [said]


def _joined(topics: Mapping[str, Stamped], stamps: dict[str, np.ndarray]) -> list[str]:
    """Move topics that are on another clock than most to that one; say who is late on his way."""
    level = {role: float(np.median(stamps[role] - one.received)) for role, one in topics.items()}
    if len(level) < 2:
        return []
    usual = common_offset(level)
    remarks = []
    for role, one in topics.items():
        off = level[role] - usual
        if is_another(level[role], usual):
            stamps[role] = stamps[role] - off
            remarks.append(
                f"{one.topic} is on another clock: its stamps are {seconds(off)} off those of the other topics, "
                "measured by the times of recording; they were moved by that."
            )
        elif off < -_LATE:
            remarks.append(
                f"The messages of {one.topic} were recorded {-level[role]:.2f} s after their stamps; if they do not "
                "come that late, its clock is behind."
            )
    return remarks


def common_offset(offsets: Mapping[str, float]) -> float:
    """Return by how much the clock of most topics is off [s], of their own; of two clocks with as many, the nearer."""
    near = {a: sum(abs(offsets[b] - offsets[a]) < _BEHIND for b in offsets) for a in offsets}
    common = min(offsets, key=lambda role: (-near[role], abs(offsets[role])))
    return float(np.median([at for at in offsets.values() if abs(at - offsets[common]) < _BEHIND]))


def is_another(offset: float, usual: float) -> bool:
    """Whether a clock that is off by `offset` [s] cannot be one that is off by `usual`, however late messages are."""
    return offset - usual > _AHEAD or offset - usual < -_BEHIND


class _Step(NamedTuple):
    """A clock that was set: the first message after it, when that is [s], by how much [s], and whether that is sure."""

    first: int
    at: float
    by: float
    sure: bool


def _steps(offset: np.ndarray, received: np.ndarray) -> list[_Step]:
    """Find where stamp minus time of recording (n,) steps and stays so.

    Messages that come later from then on show the same, so a step that they might take is sure only if others show it.
    """
    found, usual = list[_Step](), float(np.median(offset))
    for i in np.flatnonzero(np.abs(np.diff(offset)) > _SET).tolist():
        before, after = offset[max(i + 1 - _LASTING, 0) : i + 1], offset[i + 1 : i + 1 + _LASTING]
        by = float(np.median(after) - np.median(before))
        stays = max(np.ptp(before), np.ptp(after)) < 0.5 * abs(by)
        if min(len(before), len(after)) == _LASTING and abs(by) > _SET and stays:
            ahead = max(np.median(before), np.median(after)) > usual + _AHEAD
            found.append(_Step(i + 1, float(received[i + 1]), by, bool(ahead) or abs(by) > _BEHIND))
    return found


def _moved_back(topics: Mapping[str, Stamped], stamps: dict[str, np.ndarray]) -> list[str]:
    """Undo what clocks were set by; the stretch before a step is right. Say each step once."""
    steps = {role: _steps(stamps[role] - one.received, one.received) for role, one in topics.items()}
    said: list[tuple[_Step, list[str]]] = []
    for role, found in steps.items():
        for one in found:
            same = [names for step, names in said if abs(one.at - step.at) < 2.0 and abs(one.by - step.by) < _SAME]
            same[0].append(role) if same else said.append((one, [role]))
    remarks, start = [], min((float(one.received[0]) for one in topics.values()), default=0.0)
    for step, roles in said:
        if len(roles) < 2 and not step.sure:
            continue
        for role in roles:
            own = next(one for one in steps[role] if abs(one.at - step.at) < 2.0 and abs(one.by - step.by) < _SAME)
            stamps[role] = stamps[role] - own.by * (np.arange(len(stamps[role])) >= own.first)
        remarks.append(
            f"The clock of {', '.join(topics[role].topic for role in roles)} was set by {seconds(step.by)} "
            f"{step.at - start:.1f} s after the start; what follows was moved back."
        )
    return remarks


def _steady(one: Stamped, stamps: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Where stamps run backwards, take the times of recording for those that are off the usual way of a message."""
    backward = int(np.sum(np.diff(stamps) < 0))
    if not backward:
        return stamps, []
    on_way = stamps - one.received
    usual = float(np.median(on_way))
    off = np.abs(on_way - usual)
    bound = max(_OUTLIER, 5.0 * float(np.median(off)))
    if np.mean(off > bound) > 0.2 or np.any(np.diff(np.where(off > bound, one.received + usual, stamps)) < 0):
        return stamps, []
    say = f"{backward} stamps of {one.topic} run backwards; for {np.sum(off > bound)} that are off "
    return np.where(off > bound, one.received + usual, stamps), [say + "the times of recording were taken."]


def _spread(one: Stamped, stamps: np.ndarray, timed: bool) -> tuple[np.ndarray, list[str]]:
    """Spread stamps that are equal, which a clock of whole tenths gives, and readings that are sent in blocks.

    Where the times of recording differ they say when the readings were; no stamp is later than the clock. Those of a
    block are those of its end. Where there are no times of recording it is taken for the clock of whole tenths.
    """
    equal = np.diff(stamps) == 0
    if not equal.any():
        return stamps, []
    say = f"{equal.sum()} of {len(stamps)} stamps of {one.topic} are equal to the one before; "
    if equal.mean() < _MANY_EQUAL:
        return stamps, [say + "of such messages the first is used."]
    apart = np.diff(one.received)
    if timed and np.mean(apart[equal] > 0.25 * np.mean(apart)) > 0.9:
        return one.received + float(np.max(stamps - one.received)), [say + "the times of recording were taken."]
    starts = np.flatnonzero(np.concatenate(([True], ~equal)))
    sizes = np.diff(np.append(starts, len(stamps)))
    steps = np.diff(stamps[starts], append=np.nan)
    steps[-1] = np.median(steps[:-1]) if len(steps) > 1 else 0.0
    within = np.arange(len(stamps)) - np.repeat(starts, sizes)
    if timed:  # blocks
        steps = np.append(steps[:1], steps[:-1])
        within = within + 1 - np.repeat(sizes, sizes)
    spread = stamps + within / np.repeat(sizes, sizes) * np.repeat(np.maximum(steps, 0.0), sizes)
    return spread, [say + ("they were spread over the time since the one before." if timed else "they were spread.")]


def seconds(value: float) -> str:
    """Return a time [s] as text; what counts from 1970 without its fractions."""
    return f"{value:.3g} s" if abs(value) >= 1e5 else f"{value:.3f} s"
