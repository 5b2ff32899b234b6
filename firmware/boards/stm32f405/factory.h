/* What differs from unit to unit: linked to the image, one factory.c for each. */
#ifndef FACTORY_H
#define FACTORY_H

#include "fl_params.h"
#include "fl_port.h"

typedef struct factory {
    uint16_t id; /* 1..2047 */
    fl_axis_params_t params[FL_AXES];
} factory_t;

extern const factory_t factory;

#endif
