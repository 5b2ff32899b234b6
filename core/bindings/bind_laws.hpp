// The firmware's laws into the module of the firmware.
#pragma once

#include "bind.hpp"

void bind_laws(nb::module_ &m);
