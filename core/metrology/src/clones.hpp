// Loops that wider vectors may run where a machine has them, with the same bits.
#pragma once

#if defined(__x86_64__) && defined(__gnu_linux__) && !defined(FL_ONE_COPY)
#define FL_CLONES __attribute__((target_clones("arch=x86-64-v4", "avx2", "default")))
#else
#define FL_CLONES
#endif
