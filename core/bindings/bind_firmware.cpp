#include "bind.hpp"

void bind_firmware(nb::module_ &m) {
    m.def_submodule("firmware");
}
