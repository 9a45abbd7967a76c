"""Protocols: frozen values whose id and digest change with every field."""

from __future__ import annotations

import dataclasses
import hashlib
import json

import pytest

from evaluate.metrics import catalogue
from evaluate.protocols.protocol import PROTOCOLS, Protocol, protocol_by_name, protocol_from_dict
from ggavatar.errors import InputError

CHANGES = {
    "split": "last-350",
    "background": "0.25,0.5,0.75",
    "mask": "binary",
    "region": "mouth",
    "resolution": "100x80",
    "resize": "none",
    "quantisation": "none",
    "psnr_aggregation": "pooled",
    "metrics": ("psnr", "ssim_3dgs", "lpips_alex", "l1"),
    "table_metrics": ("psnr",),
    "regions": ("face",),
    "test_time_optimisation": "pose",
}


@pytest.mark.parametrize("name", ["paper", "insta-350", "flash-500", "imavatar-face256", "gaussian-avatars", "strict"])
def test_named_protocols_exist_and_differ(name: str) -> None:
    protocol = protocol_by_name(name)
    assert protocol.id == f"{name}-v1"
    assert protocol_by_name(protocol.id) is protocol
    assert sum(other.digest == protocol.digest for other in PROTOCOLS.values()) == 1
    assert set(protocol.table_metrics) <= set(protocol.metrics)


def test_every_field_but_the_name_can_be_overridden_and_changes_id_and_digest() -> None:
    fields = {field.name for field in dataclasses.fields(Protocol)} - {"name", "version", "overrides"}
    assert fields == set(CHANGES)
    base = protocol_by_name("paper")
    seen = {base.digest}
    for field, value in CHANGES.items():
        changed = base.override(**{field: value})
        assert changed.overrides == (field,)
        assert f"+{field}=" in changed.id
        assert not set('/\\:*?"<>| ') & set(changed.id)
        assert changed.digest not in seen
        seen.add(changed.digest)


def test_ids_of_long_and_strange_values_still_name_a_folder() -> None:
    base = protocol_by_name("paper")
    everything = tuple(catalogue.METRICS)
    long = base.override(metrics=everything, split="file:/some where/split.json")
    other = base.override(metrics=(*everything[1:], everything[0]), split="file:/some where/split.json")
    assert len(long.id) < 200
    assert "/" not in long.id
    assert long.id != other.id


def test_overriding_back_restores_id_and_digest_and_equal_values_change_nothing() -> None:
    base = protocol_by_name("paper")
    assert base.override(background="black").override(background="white") == base
    assert base.override(background="white") is not None
    assert base.override(background="white").id == "paper-v1"
    assert base.override(resolution="256x256", background="black").id == "paper-v1+background=black,resolution=256x256"


def test_the_digest_is_the_sha256_of_canonical_json_with_the_definitions() -> None:
    protocol = protocol_by_name("strict")
    text = protocol.canonical_json()
    assert hashlib.sha256(text.encode()).hexdigest() == protocol.digest
    content = json.loads(text)
    assert json.dumps(content, sort_keys=True, separators=(",", ":")) == text
    assert content["metric_definitions"]["psnr"] == catalogue.METRICS["psnr"].definition
    assert set(content["metric_definitions"]) == set(protocol.metrics)


def test_the_digest_of_the_paper_protocol_is_pinned() -> None:
    """A change of this value means that numbers no longer compare with those published under paper-v1."""
    assert protocol_by_name("paper").digest == "f43f01b97014fce3916b0a71838458c25179496eb6fd694b9ffddc80d2189a8f"


def test_a_protocol_survives_its_own_dictionary() -> None:
    for protocol in PROTOCOLS.values():
        content = json.loads(json.dumps({"id": protocol.id, "digest": protocol.digest, **protocol.as_dict()}))
        assert protocol_from_dict(content) == protocol


def test_unknown_names_fields_and_values_are_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match="insta-350"):
        protocol_by_name("insta350")
    with pytest.raises(InputError, match="did you mean background"):
        protocol_by_name("paper").override(backgroud="black")
    with pytest.raises(InputError, match="lpips_alex"):
        protocol_by_name("paper").override(metrics=("lpips_alx",), table_metrics=("lpips_alx",))
    with pytest.raises(InputError, match="not measured"):
        protocol_by_name("paper").override(metrics=("psnr",))
    for field, value in (
        ("background", "mauve"),
        ("background", "10,20,30"),
        ("resolution", "512"),
        ("resolution", "0x5"),
    ):
        with pytest.raises(InputError, match=f"--{field}"):
            protocol_by_name("paper").override(**{field: value})
    with pytest.raises(InputError, match="fields of a protocol"):
        protocol_from_dict({"version": 1})


def test_background_and_size_are_numbers() -> None:
    protocol = protocol_by_name("paper").override(background="0,0.2,1", resolution="640x480")
    assert protocol.background_rgb == pytest.approx((0, 0.2, 1))
    assert protocol.size == (640, 480)
    assert protocol_by_name("folders").background_rgb is None
    assert protocol_by_name("folders").size is None


def test_regions_add_masked_columns_of_metrics_that_have_them() -> None:
    columns = protocol_by_name("folders").override(regions=("face",)).columns
    assert columns == ("psnr", "ssim", "ssim_3dgs", "lpips_alex", "psnr@face", "ssim@face", "ssim_3dgs@face")
    assert catalogue.title_of("psnr@face") == "PSNR face"
    assert catalogue.metric_of("psnr@face").arrow == "↑"


def test_one_color_has_one_protocol_however_it_is_written() -> None:
    paper = protocol_by_name("paper")
    assert paper.override(background="1,1.0, 1") == paper
    digests = {paper.override(background=text).digest for text in ("0.5,0.5,0.5", ".5, .50,5e-1")}
    assert len(digests) == 1
    assert paper.override(background=".5,0,1").id == "paper-v1+background=0.5-0-1"
    assert paper.override(background=".5,0,1").background_rgb == (0.5, 0.0, 1.0)
