// Functions that the compiler makes once for every processor and once for those that take more numbers at
// once; the one that fits is chosen when the program starts. Both give the same bits.
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(FL_ONE_COPY)
#define FL_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define FL_CLONES
#endif
#define FL_INLINE __attribute__((always_inline)) inline
