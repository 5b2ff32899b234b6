#include "bind.hpp"

NB_MODULE(_core, m) {
    m.doc() = "What must be fast: geometry, firmware, twin, planning. Angles in rad, lengths in mm.";
    bind_firmware(m);
    bind_geometry(m);
    bind_metrology(m);
    bind_planning(m);
    bind_twin(m);
}
