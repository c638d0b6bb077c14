#pragma once

#define NPY_NO_DEPRECATED_API NPY_1_23_API_VERSION
#define PY_ARRAY_UNIQUE_SYMBOL nts_numpy
#ifndef NTS_IMPORT_NUMPY // by module.cpp
#define NO_IMPORT_ARRAY
#endif
#include <numpy/arrayobject.h>
