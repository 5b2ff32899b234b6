#include "bind.hpp"

void bind_twin(nb::module_ &m) {
    m.def_submodule("twin");
}
