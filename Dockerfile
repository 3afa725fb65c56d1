# landfix as a container, for amd64 and arm64: what flies, without the tools of the ground.
#
#     docker build -t landfix .                 docker buildx build --platform linux/arm64 -t landfix .     for a Jetson or a Raspberry Pi
#     docker build --build-arg CAMERAS=no -t landfix .                 without OpenCV, 160 MB less
#     docker run --rm landfix doctor
#     docker run --rm --network host -v /etc/landfix:/etc/landfix:ro -v landfix:/var/lib/landfix landfix
#
# The volume keeps logs, the last state and the compiled kernels: docs/install.md.

FROM python:3.11-slim-bookworm AS build
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends binutils && rm -rf /var/lib/apt/lists/*
RUN python -m venv /opt/landfix
ENV PATH=/opt/landfix/bin:$PATH PIP_NO_CACHE_DIR=1
WORKDIR /src
COPY requirements-flight.lock ./
RUN pip install --no-compile --no-deps --require-hashes -r requirements-flight.lock
# CAMERAS=no leaves out OpenCV: fixes and odometry then come from other programs.
ARG CAMERAS=yes
RUN if [ "$CAMERAS" = no ]; then pip uninstall --yes opencv-python-headless; fi
COPY . .
RUN pip install --no-compile --no-deps .
# Tests of others, dialects of MAVLink that are not spoken, symbol tables. Not of libraries that auditwheel has patched: strip breaks them.
WORKDIR /opt/landfix/lib/python3.11/site-packages
RUN find . -type d -name tests -prune -exec rm -r {} + \
    && find pymavlink/dialects -type f ! -name __init__.py ! -name all.py ! -name common.py ! -name ardupilotmega.py -delete \
    && strip --strip-unneeded llvmlite/binding/*.so zenoh/*.so zstandard/*.so \
    && pip uninstall --yes pip setuptools

FROM python:3.11-slim-bookworm
RUN useradd --system --uid 10001 --create-home --home-dir /var/lib/landfix landfix
COPY --from=build /opt/landfix /opt/landfix
ENV PATH=/opt/landfix/bin:$PATH NUMBA_CACHE_DIR=/var/lib/landfix/kernels PYTHONPYCACHEPREFIX=/var/lib/landfix/bytecode
USER 10001
WORKDIR /var/lib/landfix
VOLUME /var/lib/landfix
STOPSIGNAL SIGTERM
ENTRYPOINT ["landfix"]
CMD ["run", "-c", "/etc/landfix/vehicle.toml"]
