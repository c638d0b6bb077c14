"""Forms: how FFCx compiles them."""

from functools import partial

from dolfinx import fem

__all__ = ["compile_form"]

# As fast as -ffast-math but for the assumption that there are no NaNs.
_OPTIONS = {
    "cffi_extra_compile_args": [
        "-O3",
        "-march=native",
        "-ffp-contract=fast",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fno-signed-zeros",
        "-fassociative-math",
    ]
}

compile_form = partial(fem.form, jit_options=_OPTIONS)
