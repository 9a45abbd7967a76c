"""The avatar file: opened like the run, bit by bit; without photographs; refused when anything is wrong with it.

Also covers `ggavatar/formats/avatar_file/reader.py`, `ggavatar/formats/avatar_file/tracking.py` and
`ggavatar/data/capture_without_images.py`. Reference: the run that a file was exported from.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load, save

from ggavatar.data.capture import Capture
from ggavatar.errors import InputError
from ggavatar.formats.any_avatar import open_avatar
from ggavatar.formats.avatar_file import container
from ggavatar.formats.avatar_file.container import Container, read_container, write_container
from ggavatar.formats.avatar_file.export import export_avatar_file
from ggavatar.formats.avatar_suffix import is_avatar_file, results_beside
from ggavatar.io.dataclass_json import to_plain
from ggavatar.pretrained.resolve import ModelFinder, ModelUnavailable
from ggavatar.training.registry import load as load_method
from ggavatar.training.registry import names as method_names
from ggavatar.training.run_folder import Run, RunConfig
from tests.support.untrained_avatars import run_of, untrained

METHODS = [name for name in method_names() if "_with" not in name]


class NoNetworks(ModelFinder):
    """Finds nothing."""

    def find(self, name: str) -> Path:
        raise ModelUnavailable(name)


def stored(method: str, capture: Capture, path: Path) -> Run:
    """An untrained run with the configuration that built it, written to `path`."""
    avatar, reader = untrained(method, capture, 100)
    config = RunConfig(method, str(capture.folder), method_config=to_plain(load_method(method).config("default")))
    config = dataclasses.replace(config, training=dataclasses.replace(config.training, steps=100))
    run = dataclasses.replace(run_of(avatar, reader, capture), method=method, config=config)
    export_avatar_file(run, path, overwrite=False, finder=NoNetworks())
    return run


@pytest.fixture(scope="module")
def run(toy_capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("stored") / "me.ggavatar"
    return dataclasses.replace(stored("ggavatar_plus", toy_capture, path), provenance={"file": path})


@pytest.fixture(scope="module")
def file(run: Run) -> Path:
    return Path(run.provenance["file"])


@pytest.mark.parametrize("method", METHODS)
def test_every_method_poses_as_the_run_does(method: str, toy_capture: Capture, tmp_path: Path) -> None:
    """Methods come from the registry: one that keeps something beside its state fails here."""
    path = tmp_path / "a.ggavatar"
    run, opened = stored(method, toy_capture, path), open_avatar(path)
    assert opened.method == method and opened.split == run.split and opened.folder == tmp_path / "a"
    for number in (run.split.train[0], run.split.test[0]):
        with torch.no_grad():
            here, there = (one.avatar.gaussians(one.reader.drive(number)) for one in (run, opened))
        for name in ("means", "quats", "scales", "opacities", "colors"):
            assert torch.equal(getattr(here, name), getattr(there, name)), name
        assert torch.equal(run.reader.camera(number).intrinsics, opened.reader.camera(number).intrinsics)


def test_a_file_says_what_it_is_and_nothing_of_the_machine(run: Run, file: Path) -> None:
    with zipfile.ZipFile(file) as archive:
        names = archive.namelist()
        described = json.loads(archive.read("avatar.json"))
        everything = b"".join(archive.read(name) for name in names)
    assert names == ["avatar.json", "head.safetensors", "avatar.safetensors", "tracking.safetensors"]
    assert (described["schema"], described["version"]) == ("ggavatar-avatar", 1)
    assert "likeness" in described["notes"]["consent"] and described["notes"]["license"]
    assert str(run.capture.folder).encode() not in everything and b"PNG" not in everything
    first = described["axes"][0]
    seen = run.capture.tracking.expression[[run.capture.row(number) for number in run.split.train], 0]
    np.testing.assert_allclose([first["low"], first["high"]], np.quantile(seen, [0.01, 0.99]), atol=1e-5)
    pose = np.reshape(described["neutral"]["head_to_camera"], (4, 4))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-5)


def test_equal_runs_give_equal_bytes_and_files_give_files(run: Run, file: Path, tmp_path: Path) -> None:
    export_avatar_file(run, tmp_path / "again.ggavatar", overwrite=False, finder=NoNetworks())
    assert (tmp_path / "again.ggavatar").read_bytes() == file.read_bytes()
    export_avatar_file(open_avatar(file), tmp_path / "copy.ggavatar", overwrite=False)
    ours, copy = read_container(file), read_container(tmp_path / "copy.ggavatar")
    assert all(torch.equal(ours.groups["avatar"][name], value) for name, value in copy.groups["avatar"].items())
    with pytest.raises(InputError, match="--overwrite"):
        export_avatar_file(run, file, overwrite=False)


def test_photographs_are_refused_by_name(file: Path) -> None:
    capture = open_avatar(file).capture
    number = capture.frames[0]
    asked: list[Callable[[], Any]] = [
        lambda: capture.image(number), lambda: capture.mask(number), lambda: capture.image_path("images", number),
        lambda: capture.digest(), lambda: capture.head_path,
    ]  # fmt: skip
    for ask in asked:
        with pytest.raises(InputError, match=r"no photographs.*ggavatar-eval --pred"):
            ask()
    with pytest.raises(InputError, match="--step"):
        open_avatar(file, step=3)
    with pytest.raises(InputError, match="--capture"):
        open_avatar(file, capture=file.parent)


def test_licensed_heads_need_consent(run: Run, tmp_path: Path) -> None:
    flame = dataclasses.replace(run, head=dataclasses.replace(run.head, version="flame2023"))
    with pytest.raises(InputError, match=r"the file would contain.*--include-head-model"):
        export_avatar_file(flame, tmp_path / "a.ggavatar", overwrite=False, finder=NoNetworks())
    assert not list(tmp_path.iterdir())
    export_avatar_file(flame, tmp_path / "a.ggavatar", False, include_head_model=True, finder=NoNetworks())


def test_every_flipped_bit_and_every_cut_is_noticed(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    random = np.random.default_rng(0)
    broken = tmp_path / "b.ggavatar"
    for position in random.integers(0, len(whole), 150):
        data = bytearray(whole)
        data[position] ^= 1 << int(random.integers(8))
        broken.write_bytes(data)
        try:
            content = read_container(broken)
        except InputError:
            continue
        ours = read_container(file)  # a bit of the archive's bookkeeping, such as a date: the content is the same
        assert content.description == ours.description
        for group, tensors in ours.groups.items():
            assert all(torch.equal(value, content.groups[group][name]) for name, value in tensors.items())
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        broken.write_bytes(whole[:length])
        with pytest.raises(InputError):
            read_container(broken)


def rewritten(file: Path, path: Path, change: Callable[[Container], Any]) -> Path:
    """A copy with a change, and with digests that fit it: what somebody with bad intentions writes."""
    content = read_container(file)
    copied = Container(json.loads(json.dumps(content.description)), content.groups)
    change(copied)
    write_container(path, copied)
    return path


def set_tensor(group: str, name: str, change: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[Container], None]:
    def apply(content: Container) -> None:
        found = next(key for key in content.groups[group] if key.endswith(name))
        content.groups[group][found] = change(content.groups[group][found].clone())

    return apply


HOSTILE: dict[str, Callable[[Container], Any]] = {
    "triangle far away": set_tensor("avatar", "carried.face", lambda value: value + 10**9),
    "triangle below zero": set_tensor("avatar", "carried.face", lambda value: value - 10**6),
    "rows that differ": set_tensor("avatar", "learnable.quats", lambda value: value[:-1]),
    "another network": set_tensor("avatar", "last_bias", lambda value: value[:, :-1]),
    "not finite": set_tensor("avatar", "learnable.means", lambda value: value * torch.nan),
    "no such vertex": set_tensor("head", "faces", lambda value: value + 10**6),
    "frames that differ": set_tensor("tracking", "expression", lambda value: value[:-1]),
    "another camera": set_tensor("tracking", "world_to_camera", lambda value: value * 2),
    "a tensor missing": lambda content: content.groups["avatar"].popitem(),
    "no method": lambda content: content.description["config"].update(method="../evil"),
    "a setting that fills the memory": lambda content: content.description["config"]["method_config"].update(
        hidden=10**12
    ),
    **{
        f"a network {many} wide": lambda content, many=many: content.description["config"]["method_config"].update(
            latent=many
        )
        for many in (33, 10_000, 10**6, 10**7)
    },
    "a picture without end": lambda content: content.description["clip"].update(width=16384, height=16384),
    "an unknown setting": lambda content: content.description["config"].update(command="rm"),
    "no clip": lambda content: content.description.pop("clip"),
    "no head": lambda content: content.description.pop("head"),
    "no step": lambda content: content.description.update(step="three"),
    "no frames": lambda content: content.description["clip"].update(frames=[]),
    "foreign test frame": lambda content: content.description["clip"].update(test=[10**6]),
    "no size": lambda content: content.description["clip"].update(width=0),
    "no rate": lambda content: content.description["clip"].update(fps=0),
    "joints that differ": lambda content: content.description["head"].update(joint_names=["root"]),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_parts_that_do_not_fit_are_refused(what: str, file: Path, tmp_path: Path) -> None:
    """By name, and without more memory than the file justifies: the kernel's count of the most that was used."""
    path, before = rewritten(file, tmp_path / "h.ggavatar", HOSTILE[what]), peak_mebibytes()
    with pytest.raises(InputError, match=r"h\.ggavatar"):
        open_avatar(path)
    assert peak_mebibytes() - before < 700


def peak_mebibytes() -> float:
    """The most memory that this process had so far; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0.0
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def test_an_unchanged_copy_opens(file: Path, tmp_path: Path) -> None:
    """Else the test above could not fail."""
    assert open_avatar(rewritten(file, tmp_path / "h.ggavatar", lambda content: None)).step == 1


def test_hostile_archives(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    path = tmp_path / "h.ggavatar"

    def refuse(words: str, **changes: bytes | None) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in (members | changes).items():
                if data is not None:
                    archive.writestr(name, data)
        with pytest.raises(InputError, match=words):
            read_container(path)

    refuse("expected the members", **{"head.safetensors": None})
    refuse("expected the members", **{"../../escape.py": b"print()"})
    refuse("changed since it was written", **{"tracking.safetensors": members["head.safetensors"]})
    refuse("not valid JSON", **{"avatar.json": b"{"})
    described = json.loads(members["avatar.json"])
    refuse("expected the schema", **{"avatar.json": json.dumps(described | {"schema": "x"}).encode()})
    refuse("update GGAvatar", **{"avatar.json": json.dumps(described | {"version": 2}).encode()})
    refuse("avatar.json changed", **{"avatar.json": json.dumps(described | {"step": 9}).encode()})
    monkeypatch.setattr(container, "MAX_UNPACKED_BYTES", 20_000_000)
    refuse("unpacks to more", **{"head.safetensors": bytes(30_000_000)})
    monkeypatch.undo()
    refuse("expected at most 32 times its size", **{"head.safetensors": bytes(300_000_000)})


def test_an_avatar_of_zeros_is_stored_so_that_it_can_be_read(tmp_path: Path) -> None:
    """Deflated it would look like an archive that expands without end."""
    groups: dict[str, dict[str, torch.Tensor]] = {"head": {}, "avatar": {"a": torch.zeros(5_000_000)}, "tracking": {}}
    assert write_container(tmp_path / "a.ggavatar", Container({}, groups)) > 20_000_000
    assert not read_container(tmp_path / "a.ggavatar").groups["avatar"]["a"].any()


def test_tensors_of_other_types_are_neither_written_nor_read(file: Path, tmp_path: Path) -> None:
    content = read_container(file)
    content.groups["head"]["extra"] = torch.zeros(2, dtype=torch.float16)
    with pytest.raises(ValueError, match="float16"):
        write_container(tmp_path / "a.ggavatar", content)
    with pytest.raises(InputError, match="float16"):
        container._unpacked(tmp_path, "head.safetensors", save({"x": torch.zeros(2, dtype=torch.float16)}))
    with pytest.raises(InputError, match="no safetensors"):
        container._unpacked(tmp_path, "head.safetensors", b"\x01")
    assert load(save({"x": torch.zeros(1)}))["x"].shape == (1,)


def test_what_an_avatar_file_is_called(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "me.zip"
    other.write_bytes(file.read_bytes())
    (tmp_path / "text.txt").write_text("PK")
    assert is_avatar_file(file) and is_avatar_file(other) and is_avatar_file(tmp_path / "missing.ggavatar")
    assert not is_avatar_file(tmp_path) and not is_avatar_file(tmp_path / "text.txt")
    assert results_beside(file) == file.with_suffix("") and results_beside(other) == tmp_path / "me.zip-results"
    with pytest.raises(InputError, match="no such file"):
        open_avatar(tmp_path / "missing.ggavatar")


def test_measured_scores_travel_with_the_file(
    toy_capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of training frames only, and a file of a file has them too."""
    from ggavatar.data.expression_scores import measured_scores
    from ggavatar.formats.avatar_file import export

    avatar, reader = untrained("gaussian_avatars", toy_capture, 100)
    values = to_plain(load_method("gaussian_avatars").config("default"))
    run = dataclasses.replace(
        run_of(avatar, reader, toy_capture),
        method="gaussian_avatars",
        config=RunConfig("gaussian_avatars", "", method_config=values),
    )
    known = np.random.default_rng(0).uniform(size=(len(run.split.train), 52))
    with monkeypatch.context() as patched:
        patched.setattr(export, "measured_scores", lambda *_: known)
        written = export_avatar_file(run, tmp_path / "a.ggavatar", overwrite=False)
    assert not any("landmark" in note for note in written.notes)
    opened = open_avatar(tmp_path / "a.ggavatar")
    found = measured_scores(opened.capture, run.split.train, NoNetworks())
    assert found is not None
    np.testing.assert_allclose(found, known, atol=1e-6)
    assert measured_scores(opened.capture, run.split.test, NoNetworks()) is None
    export_avatar_file(opened, tmp_path / "b.ggavatar", overwrite=False, finder=NoNetworks())
    again = measured_scores(open_avatar(tmp_path / "b.ggavatar").capture, run.split.train, NoNetworks())
    np.testing.assert_array_equal(again, found)
