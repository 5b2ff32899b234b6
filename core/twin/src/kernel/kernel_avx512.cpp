#define FL_KERNEL_NAME "avx512"
#define FL_KERNEL_SYMBOL kernel_avx512
#define FL_KERNEL_WIDTH 16
#include "kernel_body.hpp"
