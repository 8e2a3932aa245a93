# scanloom without Rust, a compiler or Python of one's own:
#
#   docker build -t scanloom .
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" scanloom run SCAN -o OUT
#
# Made from two images: one compiles the wheel, the other installs it. docs/platforms.md says what was tried.

FROM rust:1.89-slim-bookworm AS build
# A stable Debian has one version of each, and newer ones put right what was unsafe.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends g++ python3-pip python3-venv \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv /build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY packaging packaging
COPY kernels kernels
COPY scanloom scanloom
COPY stages stages
COPY pipeline pipeline
COPY cli cli
RUN /build/bin/pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.12-slim-bookworm
# What Open3D's wheel takes from the system.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends \
        libegl1 libgl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir --root-user-action=ignore /wheels/*.whl \
    && rm -r /wheels \
    && useradd --create-home --uid 1000 scanloom
# Where --user names another user, who has no home in here.
ENV HOME=/tmp
WORKDIR /data
USER 1000
ENTRYPOINT ["scanloom"]
CMD ["--help"]
