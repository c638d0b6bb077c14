"""Tags with the name of their region."""

__all__ = ["NamedTag"]


class NamedTag(int):
    """Tag of a physical group of gmsh, a number with the name of the group. Local.

    Args:
        tag: The number.
        name: The name; empty if there is none.

    Attributes:
        name: The argument.
    """

    name: str

    def __new__(cls, tag: int, name: str = "") -> "NamedTag":
        number = super().__new__(cls, tag)
        number.name = name
        return number

    @staticmethod
    def name_of(tag: int, kind: str) -> str:
        """Name of a tagged region, with its number if it has no name. Local.

        Args:
            tag: A tag with or without a name.
            kind: Kind of the region, such as ``"body"``.
        """
        return getattr(tag, "name", "") or f"{kind} {int(tag)}"
