#define FL_KERNEL_NAME "baseline"
#define FL_KERNEL_SYMBOL kernel_baseline
#define FL_KERNEL_WIDTH (lane_count < 4 ? lane_count : 4)
#include "kernel_body.hpp"
