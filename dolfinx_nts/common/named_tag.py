"""Tags that know the name of the region which they stand for."""

__all__ = ["NamedTag"]


class NamedTag(int):
    """Tag of a physical group of gmsh, a number that has the name of the group. Local.

    Args:
        tag: The number.
        name: The name; empty if there is none.

    Attributes:
        name: The argument.
    """

    name: str

    def __new__(cls, tag: int, name: str = "") -> "NamedTag":
        """Make the number and keep the name."""
        number = super().__new__(cls, tag)
        number.name = name
        return number

    @staticmethod
    def name_of(tag: int, kind: str) -> str:
        """Name of what a tag stands for, by its number where it has no name. Local.

        Args:
            tag: A tag with or without a name.
            kind: What the tag stands for, such as ``"body"``.
        """
        return getattr(tag, "name", "") or f"{kind} {int(tag)}"
