#include "bind.hpp"

NB_MODULE(_core, m) {
    // a process may end while a task of its own is under way: what it holds then is nothing a user can act on
    nb::set_leak_warnings(false);
    m.doc() = "What must be fast: geometry, firmware, twin, planning. Angles in rad, lengths in mm.";
    bind_firmware(m);
    bind_geometry(m);
    bind_metrology(m);
    bind_planning(m);
    bind_twin(m);
}
