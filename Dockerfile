# unbend for clusters: `docker build -t unbend .`, then `docker run -v $PWD:/season unbend run season.yaml`.
FROM python:3.12-slim

# Compiled code lies in the image; whoever runs it may add to it.
ENV XDG_CACHE_HOME=/var/cache \
    OPENBLAS_NUM_THREADS=1 \
    PIP_NO_CACHE_DIR=1

COPY pyproject.toml README.md LICENSE /source/
COPY .locks /source/.locks
COPY pipeline /source/pipeline
RUN pip install --require-hashes -r /source/.locks/build.txt -r /source/.locks/cluster.txt \
    && pip install --no-deps --no-build-isolation /source \
    && unbend warm \
    && chmod -R a+rwX /var/cache/unbend \
    && rm -r /source

RUN useradd --create-home crew
USER crew
WORKDIR /season
ENTRYPOINT ["unbend"]
CMD ["--help"]
