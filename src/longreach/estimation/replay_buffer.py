"""Events in the order of their stamps, however they arrive: a late one goes back to the state before it.

The state after every event of the last `history` seconds is kept. What came after a late event is taken again, so the
result is that of sorted input. A stamp far ahead is not believed at once: one wrong clock must not carry the state off,
and a real gap must not stop it. Such events wait until `patience` others follow within the longest gap, `history`
seconds long, with nothing nearer in between. Then all of them are taken.
"""

from collections.abc import Callable, Iterable
from heapq import merge
from typing import Any, NamedTuple

Key = tuple[Any, ...]  # stamp [s], then what goes first at one stamp


class Settings(NamedTuple):
    """history [s]: how late an event may come; longest_gap [s]: how far ahead; patience: others that confirm it."""

    history: float
    longest_gap: float
    patience: int


class Entry(NamedTuple):
    """An event (None: the start), the state after it, and what became of it."""

    key: Key
    event: Any
    state: Any
    outcome: Any = None


class ReplayBuffer(NamedTuple):
    """entries: the recent past, oldest first, the last one is the present. waiting: events too far ahead."""

    entries: tuple[Entry, ...]
    waiting: tuple[tuple[Key, Any], ...] = ()

    @property
    def newest(self) -> Entry:
        """The present."""
        return self.entries[-1]


class Decided(NamedTuple):
    """An event, and its outcome where it was taken, else why it was refused."""

    key: Key
    event: Any
    outcome: Any
    refused: str = ""


def init(key: Key, state: Any) -> ReplayBuffer:
    """Start with a state."""
    return ReplayBuffer((Entry(key, None, state),))


def step(
    buffer: ReplayBuffer, events: Iterable[tuple[Key, Any]], take: Callable[[Any, Key, Any], tuple[Any, Any]],
    settings: Settings,
) -> tuple[ReplayBuffer, list[Entry], list[Decided]]:  # fmt: skip
    """Take events in the order of arrival, with the same result as one call for each.

    take: from a state, a key and an event to the state after it and an outcome. Returns also the entries that are
    settled, which nothing that comes can change, oldest first, and what was decided: events too far ahead are not yet.
    """
    believed, decided, waiting = _judged(buffer, events, settings)
    entries, settled = list(buffer.entries), list[Entry]()
    later: list[tuple[Key, int, Any]] = []
    if believed:
        believed.sort(key=lambda one: one[0])  # stable: events of one key stay in the order of arrival
        while len(entries) > 1 and entries[-1].key > believed[0][0]:
            entry = entries.pop()
            later.append((entry.key, -1, entry.event))
        for i, (key, place, event) in enumerate(merge(reversed(later), believed, key=lambda one: one[0])):
            state, outcome = take(entries[-1].state, key, event)
            entries.append(Entry(key, event, state, outcome))
            if place >= 0:
                decided[place] = Decided(key, event, outcome)
            if i % 100 == 99:
                settled += _settle(entries, settings.history)
        settled += _settle(entries, settings.history)
    return ReplayBuffer(tuple(entries), tuple(waiting)), settled, decided


def _settle(entries: list[Entry], history: float) -> list[Entry]:
    """Cut off the entries before the last one that is older than the history."""
    first, oldest = 0, entries[-1].key[0] - history
    while first + 1 < len(entries) and entries[first + 1].key[0] < oldest:
        first += 1
    settled = entries[:first]
    del entries[:first]
    return settled


def _judged(
    buffer: ReplayBuffer, events: Iterable[tuple[Key, Any]], settings: Settings
) -> tuple[list[tuple[Key, int, Any]], list[Decided], list[tuple[Key, Any]]]:
    """Tell events to take, with their places in the second list, from those that are refused or wait."""
    history, gap, patience = settings
    believed: list[tuple[Key, int, Any]] = []
    decided: list[Decided] = []
    waiting, newest = list(buffer.waiting), buffer.newest.key[0]

    def believe(key: Key, event: Any) -> None:
        nonlocal newest
        believed.append((key, len(decided), event))
        decided.append(Decided(key, event, None))
        newest = max(newest, key[0])

    for key, event in events:
        lead = key[0] - newest
        if lead < -history:
            late = f"too late: {-lead:.3f} s behind, the history goes back {history:g} s"
            decided.append(Decided(key, event, None, late))
            continue
        if newest > float("-inf") and lead > gap:
            far = bool(waiting) and abs(key[0] - max(w[0][0] for w in waiting)) > gap
            ahead, waiting = (waiting, [(key, event)]) if far else ([], [*waiting, (key, event)])
        else:
            ahead, waiting = waiting, []
        decided += [Decided(*early, None, f"too far ahead: the longest prediction is {gap:g} s") for early in ahead]
        stamps = [w[0][0] for w in waiting]
        if len(waiting) > patience and max(stamps) - min(stamps) >= history:
            for early in waiting:
                believe(*early)
            waiting = []
        elif not waiting:
            believe(key, event)
    return believed, decided, waiting
