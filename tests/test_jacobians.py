"""Every Jacobian of the package is compared with finite differences somewhere."""

import ast
import re
from pathlib import Path

import longreach

PACKAGE = Path(longreach.__file__).parent
DERIVATIVE = re.compile(r"(^|_)(jacobian|hessian|gradient)(_|$)")
SEEN_AS = {"Kinematics": "MobileManipulator"}  # a base class, and the class by which it is checked


def owners(tree):
    """The public functions of a module that return a derivative; of methods, their classes."""
    for node in tree.body:
        inside = node.body if isinstance(node, ast.ClassDef) else [node]
        for function in inside:
            if isinstance(function, ast.FunctionDef) and DERIVATIVE.search(function.name) and node.name[0] != "_":
                yield SEEN_AS.get(node.name, node.name)


def test_every_jacobian_goes_through_the_check_with_finite_differences():
    files = [path for path in PACKAGE.rglob("*.py") if not path.stem.endswith("kernels")]
    found = {owner for path in files for owner in owners(ast.parse(path.read_text(encoding="utf-8")))}
    assert {"right_jacobian", "MobileManipulator"} <= found
    texts = [path.read_text(encoding="utf-8") for path in Path(__file__).parent.rglob("test_*.py")]
    checked = "\n".join(text for text in texts if "assert_is_jacobian(" in text)
    assert not sorted(name for name in found if not re.search(rf"\b{name}\b", checked))
