#include "bind.hpp"

void bind_planning(nb::module_ &m) {
    m.def_submodule("planning");
}
