"""Declarations: immutable objects that users create to describe a scene."""

from abc import ABCMeta
from inspect import Signature, signature
from typing import Any, Generic, TypeVar, cast

from dolfinx_nts.common.arguments import check_call, check_methods, with_article

__all__ = ["Declaration", "SetOnce"]

T = TypeVar("T")


class _FreezingMeta(ABCMeta):
    """Metaclass that checks the call, and freezes an object after its ``__init__``."""

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        check_call(cls, args, kwargs)
        check_methods(cls)
        item = super().__call__(*args, **kwargs)
        item._is_complete = True
        return item

    @property
    def __signature__(cls) -> Signature:
        """Arguments of ``__init__``, which ``help`` shows instead of arguments of `__call__`."""
        make = type.__getattribute__(cls, "__init__")
        if make is object.__init__:
            return Signature()
        return Signature(list(signature(make).parameters.values())[1:])


class Declaration(metaclass=_FreezingMeta):
    """Base class of immutable objects. Local.

    A later change would be inconsistent, since steppers evaluate a declaration only once.
    """

    __slots__ = ("_is_complete",)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute of an object during its construction.

        Raises:
            AttributeError: The object is complete.
        """
        if getattr(self, "_is_complete", False):
            kind = type(self).__name__
            raise AttributeError(
                f"expected no change of {with_article(kind)} after its creation, given a new value "
                f"of {name}: create another {kind} with it, and the objects that use it again"
            )
        super().__setattr__(name, value)


class SetOnce(Generic[T]):
    """Attribute that is set once. Local.

    Args:
        advice: What to do instead of setting it again; empty for another object.
    """

    def __init__(self, advice: str = "") -> None:
        self._advice = advice

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, item: object, owner: type) -> T:
        if item is None:  # access through the class, by tools that inspect it
            return cast(T, self)
        if self._name not in vars(item):
            raise AttributeError(f"{owner.__name__} has no {self._name} before its creation")
        return cast(T, vars(item)[self._name])

    def __set__(self, item: object, value: T) -> None:
        """Set the value.

        Raises:
            AttributeError: It has been set before.
        """
        kind = type(item).__name__
        if self._name in vars(item):
            advice = self._advice or f"create a new {kind} with another {self._name}"
            raise AttributeError(
                f"expected no change of {self._name} after the creation of {with_article(kind)}: "
                f"{advice}"
            )
        vars(item)[self._name] = value
