from dolfinx_nts.meshing import read_mesh
from dolfinx_nts.materials import *
from dolfinx_nts.bodies import Body
from dolfinx_nts.surfaces import Surface
from dolfinx_nts.contact import ContactPair
from dolfinx_nts.enforcement import LagrangeMultiplier
from dolfinx_nts.integrators import *
