"""Search of mortar contact: quadrature points of facets and their segments."""
