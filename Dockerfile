# GGAvatar on CPUs, installed from its wheel.
#   docker build -t ggavatar .
#   docker run --rm -v "$PWD:/work" -v ggavatar-cache:/cache ggavatar ggavatar-demo --frames 60 --size 128 -o subject
ARG PYTHON=3.12

FROM python:${PYTHON}-slim AS wheel
WORKDIR /source
COPY pyproject.toml setup.py README.md LICENSE ./
COPY ggavatar ggavatar
COPY preprocess preprocess
COPY evaluate evaluate
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:${PYTHON}-slim
# Builds of torch without CUDA, a tenth of the size.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
COPY constraints.txt /tmp/
RUN --mount=type=bind,from=wheel,source=/wheels,target=/wheels \
    python -m pip install --no-cache-dir --extra-index-url "${TORCH_INDEX}" -c /tmp/constraints.txt \
    "$(echo /wheels/ggavatar-*.whl)[view]" \
    && useradd --create-home --uid 1000 user \
    && install -d -o user -g user /cache /work
USER 1000
# Compiled kernels and model files: keep them in a volume.
ENV XDG_CACHE_HOME=/cache \
    GGAVATAR_CACHE=/cache
VOLUME /cache
WORKDIR /work
CMD ["ggavatar-train", "--help"]
