// Which kernels run here.
#include <vector>

#include "fiberloom/twin/axis_group.hpp"

namespace fl::twin {

extern const Kernel kernel_baseline;
#ifdef FL_TWIN_X86
extern const Kernel kernel_avx2, kernel_avx512;
#endif

namespace {

std::vector<const Kernel *> kernels_of_this_machine() {
    std::vector<const Kernel *> found = {&kernel_baseline};
#ifdef FL_TWIN_X86
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2");
    if (avx2) found.push_back(&kernel_avx2);
    if (avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
        found.push_back(&kernel_avx512);
#endif
    found.push_back(nullptr);
    return found;
}

} // namespace

const Kernel *const *kernels() {
    static const std::vector<const Kernel *> found = kernels_of_this_machine();
    return found.data();
}

} // namespace fl::twin
