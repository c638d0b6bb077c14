# The package on the image of DOLFINx.
#
#   docker build --tag dolfinx_nts .
#   docker run --rm --volume "$PWD":/work --workdir /work dolfinx_nts python3 impact.py
ARG DOLFINX=v0.9.0
FROM dolfinx/dolfinx:${DOLFINX}
COPY . /opt/dolfinx_nts
RUN pip install --no-cache-dir "/opt/dolfinx_nts[plot,mesh]"
