"""What can be set in an estimation."""

import pytest
from pydantic import ValidationError

from longreach.app.configuration import EstimateConfig


@pytest.mark.parametrize(
    "changes", [{"sources": ()}, {"sources": ("sonar",)}, {"colour": 1}, {"filter": {"history": -1}}]
)
def test_what_cannot_be_set_is_refused(changes):
    with pytest.raises(ValidationError):
        EstimateConfig.model_validate(changes)


def test_every_setting_says_what_it_is():
    def fields(model):
        for name, field in model.model_fields.items():
            nested = getattr(field.annotation, "model_fields", None)
            if nested:
                yield from fields(field.annotation)
            else:
                yield f"{model.__name__}.{name}", field.description

    assert not [name for name, description in fields(EstimateConfig) if not description]
