// Marks a hot loop to be compiled for several generations of x86-64 and chosen at run time.
#pragma once

// Sanitizers instrument the resolvers that choose, which run before the sanitizer is up.
#if defined(__x86_64__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define LIGHTSKETCH_VECTORISED \
  __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define LIGHTSKETCH_VECTORISED
#endif
