"""Strong scaling: the same impact on any number of ranks."""

# # Strong scaling
#
# Run this script on several numbers of ranks, one after the other, in one folder:
#
#     for n in 1 2 4; do mpirun -n $n python3 demo_scaling.py; done
#
# Each run adds a line to `scaling.csv`, then prints and draws all lines.
#
# You will learn
#
# - that a script needs no change to run on several ranks,
# - where the time is spent: `stepper.timings`,
# - that the result does not depend on the number of ranks.
#
# ## Problem
#
# The scene is that of the first tutorial with a finer mesh: 20 736 hexahedra
# in the ball and 3 200 in the plate, about 120 000 unknowns. In 20 steps of
# 2 ms, the ball flies 0.02 m and then touches the plate.
#
# ## Equations
#
# With the times $t_1$ and $t_n$ on one and on n ranks, speed-up and efficiency are
#
# $$ s_n = \frac{t_1}{t_n}, \qquad e_n = \frac{s_n}{n}. \tag{1} $$

# +
import csv
import os
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts

full = 20
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
n = 24 if num_steps == full else 6  # hexahedra along an edge of the ball


def build(model):
    """Add the ball and the plate."""
    radii = {"inner_radius": 0.8, "outer_radius": 1.0, "layers": n // 4}
    parts.add_hollow_ball(model, "ball", centre=(0, 0, 1.02), cells_per_edge=n, **radii)
    plate = {"corner": (-2, -2, -0.4), "size": (4, 4, 0.4)}
    cells = (5 * n // 3, 5 * n // 3, max(n // 12, 1))
    parts.add_box(model, "plate", cells=cells, **plate)


comm = MPI.COMM_WORLD
mesh, cells, facets, tag = nts.read_mesh(build, comm)
V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
rubber = nts.SaintVenantKirchhoff(E=1.0e5, nu=0.4, rho=1.0e3, one_point=())  # Pa, -, kg/m^3
ball, plate = (nts.Body(V, cells, tag[name], rubber) for name in ("ball", "plate"))
surfaces = [nts.Surface(V, facets, tag[name]) for name in ("ball_outer", "plate_top")]
stepper = nts.EnergyMomentum([ball, plate], [nts.ContactPair(*surfaces)], dt=0.002)
stepper.set_velocity(ball, (0.0, 0.0, -1.0))  # m/s
diagnostics = nts.Diagnostics(stepper)
start = diagnostics.balance().total_energy
stepper.advance()  # compiles the forms
# -

# ## Run

# +
comm.barrier()
begin = MPI.Wtime()
active = [step.num_active for step in stepper.run(until=num_steps * stepper.dt)]
seconds = comm.allreduce(MPI.Wtime() - begin, MPI.MAX) / len(active)
# -

# ## Checks
#
# The energy is constant on any number of ranks, and the energies and the
# number of active nodes are those of the other runs in the folder.

# +
end = diagnostics.balance()
assert abs(end.total_energy / start - 1) < 1e-10
unknowns = 3 * V.dofmap.index_map.size_global
row = {"ranks": comm.size, "unknowns": unknowns, "seconds": seconds}
row |= {"strain_energy": end.strain_energy, "active": active[-1]}
if comm.rank == 0:
    table = Path("scaling.csv")
    new = not table.exists()
    with table.open("a", newline="") as file:
        writer = csv.DictWriter(file, row)
        if new:
            writer.writeheader()
        writer.writerow(row)
    rows = np.atleast_1d(np.genfromtxt(table, delimiter=",", names=True))
    assert np.ptp(rows["strain_energy"]) <= 1e-8 * start and np.ptp(rows["active"]) == 0
    print("ranks  seconds a step  speed  efficiency")
    for line in rows:
        speed = rows["seconds"][0] / line["seconds"]
        efficiency = speed * rows["ranks"][0] / line["ranks"]
        print(f"{line['ranks']:5.0f}  {line['seconds']:14.3f}  {speed:5.2f}  {efficiency:10.0%}")
    phases = ", ".join(f"{name} {t:.2f} s" for name, t in stepper.timings.seconds.items())
    print(f"this run, in all: {phases}")
# -

# ## Picture

# +
if comm.rank == 0:
    figure, axes = plt.subplots(figsize=(6.4, 4), dpi=250, layout="constrained")
    speed = rows["seconds"][0] / rows["seconds"]
    axes.plot(rows["ranks"], speed, "o", label="measured")
    axes.plot(ranks := np.unique(rows["ranks"]), ranks / rows["ranks"][0], "--", label="ideal")
    axes.set(xlabel="ranks", ylabel="speed, first run = 1", xticks=ranks, ylim=(0, None))
    axes.legend()
    figure.savefig("scaling.png")
