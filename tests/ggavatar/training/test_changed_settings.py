"""What differs from the preset is told apart from what does not, as config.json gives it back."""

from __future__ import annotations

import dataclasses
import json

import pytest

from ggavatar.training import registry
from ggavatar.training.changed_settings import changed_settings
from ggavatar.training.plan import preset
from ggavatar.training.run_folder import RunConfig


@pytest.mark.parametrize("method", ["ggavatar", "point_avatar", "ggavatar_plus_without_torso"])
def test_a_preset_changes_nothing_of_itself(method: str) -> None:
    """Lists for tuples, other lengths and settled features are no changes."""
    stored = json.loads(json.dumps(dataclasses.asdict(registry.load(method).config("fast"))))
    plan = dataclasses.replace(preset("fast", "cpu"), steps=7, eval_every=0)
    config = RunConfig(method, "capture", preset="fast", training=plan)
    assert changed_settings(dataclasses.replace(config, method_config=stored)) == {}
    changed = {**stored, "perceptual_weight": 0.5, "perceptual_features": "random"}
    roomy = dataclasses.replace(config, training=dataclasses.replace(plan, max_gaussians=9), method_config=changed)
    assert changed_settings(roomy) == {"max_gaussians": 9, "perceptual_weight": 0.5}


def test_an_unknown_method_has_the_changes_of_the_plan() -> None:
    plan = dataclasses.replace(preset("default", "cpu"), cooling=0.1)
    assert changed_settings(RunConfig("removed_method", "capture", training=plan)) == {"cooling": 0.1}
