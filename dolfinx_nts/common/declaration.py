"""Declarations: objects that say what a user means, and never change."""

from abc import ABCMeta
from typing import Any

__all__ = ["Declaration"]


class _Completing(ABCMeta):
    """Metaclass that closes an object when its ``__init__`` is done."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        item = super().__call__(*args, **kwargs)
        item._is_complete = True
        return item


class Declaration(metaclass=_Completing):
    """Base of objects that set their attributes when they are made, and never again. Local.

    Steppers take what they need of a declaration once, so that a change would be ignored in
    some places and obeyed in others.
    """

    __slots__ = ("_is_complete",)

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse to change a complete object.

        Raises:
            AttributeError: The object is complete.
        """
        if getattr(self, "_is_complete", False):
            kind = type(self).__name__
            raise AttributeError(
                f"expected another {kind}, as none changes after it was made, given a new value "
                f"of {name}: make a {kind} with it, and a stepper with that {kind}"
            )
        super().__setattr__(name, value)
