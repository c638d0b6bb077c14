"""A run is interrupted in the middle of an impact and goes on."""

# # Resume after an interruption
#
# A rubber ball drops onto the floor. In the middle of the impact somebody
# presses Ctrl-C. The same script, started again, continues the run.
#
# You will learn
#
# - how to write checkpoints and how to resume, with two arguments,
# - that the resumed run gives the same results as an uninterrupted one,
# - that its table has no gap.
#
# ## Problem
#
# The ball is solid, with R = 0.1 m, E = 0.1 MPa, $\nu$ = 0.4 and
# $\rho$ = 1000 kg/m³. Its lowest point starts at z = 5 mm, with the velocity
# $v_0$ = 0.5 m/s downwards; g = 9.81 m/s², and the floor is the plane z = 0.
#
# ## Equations
#
# The impulse of the floor is the change of the ball's momentum plus the
# impulse that balances its weight:
#
# $$ \sum_n f_n h = p(t) - p(0) + m g t. \tag{1} $$
#
# The left side is summed over the rows of the table, some of which are written
# before the interruption and some after it.

# +
import os
import signal

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import dolfinx_nts as nts
from dolfinx_nts import parts, plotting

comm = MPI.COMM_WORLD
R, height, speed, g, dt, full = 0.1, 0.005, 0.5, 9.81, 5e-3, 60  # m, m, m/s, m/s^2, s
num_steps = int(os.environ.get("NTS_DEMO_STEPS", str(full)))  # The tests shorten it.
middle = 10  # step of the interruption, in which the ball touches


def build(model):
    """Add the ball."""
    ball = {"centre": (0, 0, R + height), "radius": R, "cells_per_edge": 4, "layers": 2}
    parts.add_solid_ball(model, "ball", **ball)


def new_stepper():
    """Set the scene, as a script does that is started again."""
    mesh, cells, facets, tag = nts.read_mesh(build, comm)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    ball = nts.Body(V, cells, tag["ball"], nts.NeoHookean(E=1e5, nu=0.4, rho=1e3))
    floor = nts.RigidPlane((0, 0, 0), (0, 0, 1))
    contact = nts.ContactPair(nts.Surface(V, facets, tag["ball_outer"]), floor)
    loads = [nts.Gravity([ball], (0, 0, -g))]
    stepper = nts.EnergyMomentum([ball], [contact], dt=dt, loads=loads)
    stepper.set_velocity(ball, (0, 0, -speed))
    return stepper


def run(name, resume=False, interrupt_at=None):
    """Run to the end or to the interruption; also returns the first step."""
    stepper = new_stepper()
    with nts.Recorder(name, stepper, every=5, checkpoint_every=5, resume=resume) as record:
        first = stepper.step
        for step in stepper.run(until=num_steps * dt):
            if step.step == interrupt_at and comm.rank == 0:
                signal.raise_signal(signal.SIGINT)  # Ctrl-C
            record.write(step)
    return stepper, first


# -

# ## Three runs
#
# Ctrl-C takes effect when the current step is complete and a checkpoint is
# written. In your own script, set `resume=True` from the start: if there is no
# checkpoint, the run simply starts from the beginning.

# +
run("resume_whole")
try:
    run("resume", interrupt_at=middle)
except KeyboardInterrupt:
    comm.barrier()
resumed, first = run("resume", resume=True)
# -

# ## Pictures
#
# The pictures show the ball at the end, and the force of the floor, which has no gap at the
# interruption.

plotting.snapshot(resumed, "resume.png")

plotting.forces("resume.csv", "resume_forces.png")

# ## Checks
#
# The resumed run starts where the interrupted one stopped, and its rows are
# those of the uninterrupted run. The impulse of the floor is that of equation
# (1), and the energy changes only by the work of the weight.

# +
assert first == middle
comm.barrier()
table, other = (
    np.genfromtxt(f"{name}.csv", delimiter=",", names=True) for name in ("resume", "resume_whole")
)
assert np.array_equal(table["step"], np.arange(num_steps + 1))
columns = ("kinetic_energy", "strain_energy", "linear_momentum_z", "contact_force_z")
largest = max(np.abs(table[c] - other[c]).max() / np.abs(other[c]).max() for c in columns)
assert largest < 1e-9, largest
assert table["active_nodes"][middle] > 0

p, f = table["linear_momentum_z"], table["contact_force_z"]
m = -p[0] / speed
impulse = np.sum(f * table["dt"])
assert abs(impulse - (p[-1] - p[0] + m * g * table["time"][-1])) < 1e-10 * m * speed
change = table["total_energy"] - table["total_energy"][0] - table["energy_loads"]
assert np.abs(change).max() < 1e-10 * table["total_energy"][0]
if comm.rank == 0:
    print(f"interrupted after step {first}, tables differ by {largest:.1e}")
    print(f"impulse of the floor {impulse:.6f} N s, velocity at the end {p[-1] / m:.4f} m/s")
