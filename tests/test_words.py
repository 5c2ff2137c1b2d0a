"""Words that the package gives up for the field's words: they come into no file, and go from those that have them.

tests/words_to_replace.txt lists what is still to do, a file a line. It only gets shorter.
"""

import io
import re
import token
import tokenize
from functools import cache
from pathlib import Path

import pytest

import longreach

ROOT, PACKAGE = Path(__file__).parent.parent, Path(longreach.__file__).parent
FILES = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}
FILES |= {path.relative_to(ROOT).as_posix(): path for path in [*ROOT.glob("*.md"), *sorted(ROOT.glob("docs/*.md"))]}
TO_REPLACE = Path(__file__).with_name("words_to_replace.txt")

# Of each word: its forms as parts of names (`told` is in `told_part` and in `NotTold`), and the word to use.
NAMES = {
    "anchor": ("anchor anchors anchored", "pose clone"),
    "attachment": ("attachment", "message header"),
    "blame": ("blame blames blamed", "fault detection"),
    "cockpit": ("cockpit", "teleop, robot client"),
    "counter": ("counter counters", "wheel odometry, encoder reading"),
    "door": ("door", "authentication"),
    "doubt": ("doubt doubts doubtful", "outlier streak, prior sigma"),
    "ears": ("ears hearing hears", "subscriber"),
    "grave": ("grave gravest", "latching stop"),
    "guide": ("guide guides guided", "motion prior"),
    "led": ("led", "coupled"),
    "moment": ("moment moments", "tick record, frame"),
    "passing": ("passing", "transient stop"),
    "placed": ("placed unplaced", "pose clone"),
    "promises": ("promise promised promises", "Capabilities"),
    "promptness": ("prompt promptness", "real-time settings"),
    "pulse": ("pulse", "heartbeat"),
    "refusals": ("refusal refusals", "rejection counts"),
    "support": ("support", "inlier ratio"),
    "telling": ("telling", "publisher"),
    "told": ("told", "observable, published, commanded, predicted, as meant"),
    "trust": ("trust trusts trusted", "prior covariance"),
    "wish": ("wish wishes wished", "desired velocity"),
    "worse": ("worse", "inflated"),
}
WHOLE_NAMES = {
    "AS_STATED": "nominal",
    "Direct": "VelocityGoal",
    "Reach": "ServoGoal",
    "quick_step": "Cholesky step",
    "steps_of": "process noise",
}
# Prose in comments, texts and documents: a pattern, and the words to use.
PROSE = {
    "blame": ("blame[sd]?", "detect a fault of"),
    "doubt": ("doubts?", "uncertainty"),
    "grave": ("grave", "latching"),
    "steel and rubber": ("steel and rubber", "physical hardware"),
    "tells of": ("tells? of", "observes, determines, reports"),
    "told": ("told", "observable, published, commanded, predicted, as meant"),
    "wish": ("wish(es)?", "desired velocity"),
}
OF_LIBRARIES = {"Counter", "attachment", "bbox_to_anchor", "isTrusted", "perf_counter"}

PARTS = {form: word for word, (forms, _) in NAMES.items() for form in forms.split()}
INSTEAD = WHOLE_NAMES | {word: instead for word, (_, instead) in (NAMES | PROSE).items()}


def words_of(text, is_python):
    """The words of a text that are to be replaced."""
    found = {word for word, (pattern, _) in PROSE.items() if re.search(rf"\b{pattern}\b", text, re.IGNORECASE)}
    if is_python:
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        names = {t.string for t in tokens if t.type == token.NAME} - OF_LIBRARIES
        parts = {part.lower() for name in names for part in re.findall(r"[A-Z]*[a-z]+|[A-Z]+", name)}
        found |= names & WHOLE_NAMES.keys() | {PARTS[part] for part in parts & PARTS.keys()}
    return found


@cache
def still_there():
    """Of each file, its words that are to be replaced."""
    found = {name: words_of(path.read_text(encoding="utf-8"), path.suffix == ".py") for name, path in FILES.items()}
    return {name: words for name, words in found.items() if words}


def listed():
    lines = TO_REPLACE.read_text(encoding="utf-8").splitlines()
    return {name: set(words.split(", ")) for name, words in (line.split(": ") for line in lines)}


def lines_of(table):
    return [f"{name}: {', '.join(sorted(words))}" for name, words in sorted(table.items()) if words]


def test_no_replaced_word_comes_into_a_file():
    known = listed()
    new = {name: {w: INSTEAD[w] for w in words - known.get(name, set())} for name, words in still_there().items()}
    assert not {name: instead for name, instead in new.items() if instead}, "use the words on the right"


def test_a_word_that_went_from_a_file_is_struck_off_the_list():
    found = still_there()
    gone = {name: words - found.get(name, set()) for name, words in listed().items()}
    assert not lines_of(gone), f"python tests/test_words.py strikes them off {TO_REPLACE.name}"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("told_part = 1", {"told"}),
        ("class NotTold: pass", {"told"}),
        ("x = foretold", set()),
        ("# as it was told", {"told"}),
        ("steps_of(1)", {"steps_of"}),
        ("all_steps_of(1)", set()),
        ("legend(bbox_to_anchor=1)", set()),
        ("moved_anchors = 1", {"anchor"}),
    ],
)
def test_words_are_found_as_parts_of_names_and_in_prose(text, words):
    assert words_of(text, is_python=True) == words


if __name__ == "__main__":
    there = still_there()
    rest = {name: words & there.get(name, set()) for name, words in listed().items()}
    TO_REPLACE.write_text("".join(f"{line}\n" for line in lines_of(rest)), encoding="utf-8")
