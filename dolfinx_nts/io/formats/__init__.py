"""File formats of fields: VTKHDF, VTX and XDMF."""
