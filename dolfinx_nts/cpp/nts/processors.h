#pragma once

/// @file
/// Functions with several versions for different processors, selected at run
/// time. Functions that they call must be inlined to be compiled likewise.

#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(__clang__)
#define NTS_BY_PROCESSOR
#define NTS_FOR(processor) __attribute__((target(processor)))
#define NTS_FOR_PROCESSORS                                                     \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define NTS_FOR(processor)
#define NTS_FOR_PROCESSORS
#endif
