"""What is installed together with the package: its licences, and that docs/dependencies.md names what we ask for."""

import re
from importlib.metadata import Distribution, distribution
from pathlib import Path

from packaging.requirements import Requirement

DOCUMENT = Path(__file__).parent.parent / "docs" / "dependencies.md"
COPYLEFT = re.compile(r"\b[AL]?GPL|GNU .*General Public|\bEUPL|\bSSPL", re.IGNORECASE)


def installed_with(name: str) -> dict[str, Distribution]:
    """Every distribution that `pip install name` brings, without extras."""
    found: dict[str, Distribution] = {}
    waiting = [name]
    while waiting:
        known = distribution(waiting.pop())
        name = re.sub(r"[-_.]+", "-", known.metadata["Name"]).lower()
        if name not in found:
            found[name] = known
            requirements = [Requirement(line) for line in known.requires or []]
            waiting += [r.name for r in requirements if r.marker is None or r.marker.evaluate({"extra": ""})]
    return found


def licence(known: Distribution) -> str:
    """What the metadata says of the licence: the expression, the classifiers, the first line of the text."""
    metadata = known.metadata
    classifiers = [line for line in metadata.get_all("Classifier", []) if line.startswith("License ::")]
    text = next(iter((metadata.get("License") or "").splitlines()), "")
    return " | ".join(filter(None, [metadata.get("License-Expression"), *classifiers, text]))


def test_nothing_installed_with_the_package_is_gpl_or_lgpl():
    licences = {name: licence(known) for name, known in installed_with("longreach").items()}
    assert {"numpy", "rosbags", "apsw"} <= set(licences)
    assert not [name for name, said in licences.items() if not said]
    assert not {name: said for name, said in licences.items() if COPYLEFT.search(said)}


def test_the_check_would_see_a_gpl_package():
    assert COPYLEFT.search(licence(distribution("evo")))


def test_every_direct_dependency_is_in_the_document():
    text = DOCUMENT.read_text(encoding="utf-8")
    direct = [Requirement(line) for line in distribution("longreach").requires or []]
    assert len(direct) > 10
    assert not [r.name for r in direct if f"| {r.name} |" not in text]
