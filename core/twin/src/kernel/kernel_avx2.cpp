#define FL_KERNEL_NAME "avx2"
#define FL_KERNEL_SYMBOL kernel_avx2
#define FL_KERNEL_WIDTH 8
#include "kernel_body.hpp"
