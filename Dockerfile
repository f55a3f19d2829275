# docker build --tag challenger-bench .                            without CUDA, for any machine
# docker build --tag challenger-bench --build-arg TORCH=cu130 .    with CUDA, for machines with an NVIDIA GPU
# docker run --rm --volume "$PWD:/data" --user "$(id -u):$(id -g)" challenger-bench demo
ARG PYTHON=3.11

FROM python:${PYTHON}-slim-bookworm AS built
WORKDIR /source
COPY constraints.txt pyproject.toml MANIFEST.in README.md LICENSE ./
COPY adapters adapters
COPY benchmark benchmark
COPY generation generation
COPY leaderboard leaderboard
RUN python -m pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:${PYTHON}-slim-bookworm
# A folder of PyTorch's own index: cpu, cu130 and so on. CUDA's libraries come with it, so the image is the same otherwise.
ARG TORCH=cpu
# Extras in brackets, such as [video,serve].
ARG EXTRAS=""
COPY constraints.txt /tmp/constraints.txt
COPY --from=built /wheels /tmp/wheels
RUN python -m pip install --no-cache-dir --no-deps --index-url "https://download.pytorch.org/whl/${TORCH}" \
      "$(grep '^torch==' /tmp/constraints.txt)" \
    && python -m pip install --no-cache-dir --constraint /tmp/constraints.txt \
      "$(find /tmp/wheels -name 'challenger_bench-*.whl')${EXTRAS}" \
    && rm -r /tmp/wheels /tmp/constraints.txt \
    && useradd --uid 1000 --home-dir /data --no-create-home bench \
    && install --directory --mode 1777 /data
# Everything that is written lies in the folder that is mounted, whoever runs it.
ENV HOME=/data CHALLENGER_BENCH_CACHE=/data/challenger-cache MPLCONFIGDIR=/tmp/matplotlib OMP_NUM_THREADS=1
WORKDIR /data
USER 1000
ENTRYPOINT ["challenger-bench"]
CMD ["--help"]
