# INDI's server and simulators, for indi.yaml
FROM docker.io/library/debian:bookworm-slim
RUN apt-get update && apt-get install -y --no-install-recommends indi-bin && rm -rf /var/lib/apt/lists/*
USER nobody
ENV HOME=/tmp
