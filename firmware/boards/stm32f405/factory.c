/* A unit with the number 1 and the default parameters; a real one has those of its own identification. */
#include "factory.h"

#define X(name, unit, min, max, def, doc) .name = (float)(def),
const factory_t factory = {
    .id = 1,
    .params =
        {
            [FL_ALPHA] = {FL_AXIS_PARAMS(X)},
            [FL_BETA] = {FL_AXIS_PARAMS(X)},
        },
};
#undef X
