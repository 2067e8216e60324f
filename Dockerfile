# Image of hil for trials and offline work, on the CPU: docker build -t hil . && docker run --rm hil
# docs/how-to/use-a-container.md explains volumes, networks and torch.
# Wheels of the CPU build of torch, if the builder has them: --build-context wheels=FOLDER takes the place of this stage.
FROM scratch AS wheels
COPY constraints.txt /

FROM python:3.11-slim

# The kernels of twins are compiled with llvmlite, which pip brings; no compiler is needed.
WORKDIR /opt/hil
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY hil ./hil
COPY drivers ./drivers
COPY twin ./twin
COPY profiles ./profiles
# Editable, as in .venv: the commands find profiles/ beside the packages.
RUN pip install --no-cache-dir -c constraints.txt -e ".[stream,panel,notify]"

# The network calibrator needs torch. The registry's build brings gigabytes of CUDA, so --no-index keeps pip off it.
ARG TORCH=no
RUN --mount=type=bind,from=wheels,target=/wheels \
    if [ "$TORCH" = yes ]; then \
        pip install --no-cache-dir --no-deps -c constraints.txt --no-index --find-links /wheels torch \
        && pip install --no-cache-dir -c constraints.txt -e ".[ml]"; \
    fi

RUN useradd --create-home --uid 1000 hil && mkdir /work && chown hil:hil /work
USER hil
WORKDIR /work
ENV PYTHONUNBUFFERED=1 OPENBLAS_NUM_THREADS=1

ENTRYPOINT ["hil"]
CMD ["run", "profiles/loads/battle_10h.csv", "--virtual", "--lockstep", "--no-viewer"]
