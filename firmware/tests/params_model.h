/* What the copy of the parameters in a positioner should hold, reckoned from accepted requests alone. */
#ifndef PARAMS_MODEL_H
#define PARAMS_MODEL_H

#include <stdbool.h>
#include <string.h>

#include "fl_calibration.h"
#include "fl_commands.h"
#include "fl_crc.h"

typedef struct params_model {
    fl_axis_params_t now[FL_AXES], copy[FL_AXES];
    bool begun;
} params_model_t;

static const float params_range[][2] = {
#define X(name, unit, min, max, def, doc) {(float)(min), (float)(max)},
    FL_AXIS_PARAMS(X)
#undef X
};
enum { PARAMS = sizeof params_range / sizeof *params_range };

static inline bool params_set(params_model_t *m, int axis, uint8_t index, float value) {
    if (!m->begun || index >= PARAMS) return false;
    ((float *)&m->copy[axis])[index] = value;
    return value >= params_range[index][0] && value <= params_range[index][1];
}

static inline bool params_commit(params_model_t *m, uint32_t crc) {
    memcpy(m->now, m->copy, sizeof m->now);
    m->begun = false;
    return fl_crc_end(fl_crc_add(FL_CRC_START, m->now, sizeof m->now)) == crc &&
           fl_params_fault(&m->now[0]) < 0 && fl_params_fault(&m->now[1]) < 0;
}

/* Values set one by one, taken together; 41 and 112 set voltages. in_force: what the positioner works with.
 * False: the request should have been refused. */
static inline bool params_accepted(params_model_t *m, const fl_axis_params_t in_force[FL_AXES],
                                   const fl_can_frame_t *f, uint8_t command) {
    uint32_t crc;
    float value;
    memcpy(&crc, f->data, sizeof crc);
    memcpy(&value, f->data + 1, sizeof value);
    switch (command) {
    case 231:
        memcpy(m->copy, m->now, sizeof m->copy);
        m->begun = true;
        return crc == fl_params_table_crc();
    case 232:
    case 233:
        return params_set(m, command - 232, f->data[0], value);
    case 234:
        return params_commit(m, crc);
    case 41:
    case 112:
        memcpy(m->now, in_force, sizeof m->now);
        return true;
    default:
        return true;
    }
}

#endif
