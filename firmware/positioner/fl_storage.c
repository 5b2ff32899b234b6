#include "fl_storage.h"

#include "fl_crc.h"
#include "fl_status.h"

/* Change that of a record with every change of it: old ones are then not read. */
enum { CALIBRATION_FORMAT = 2, POSITION_FORMAT = 1 };

typedef struct header {
    uint32_t format, sequence;
} header_t;

typedef struct calibration_record {
    header_t header;
    fl_axis_params_t params[FL_AXES];
    int32_t datum_ref_cnt[FL_AXES], offset_cnt[FL_AXES];
    uint32_t trajectories;
    uint8_t hall_calibrated, datum_calibrated, cogging_calibrated, unused;
    uint32_t crc;
} calibration_record_t;

typedef struct position_record {
    header_t header;
    int32_t position_cnt[FL_AXES], rotor_cnt[FL_AXES];
    uint8_t moving, datum_known, unused[2];
    uint32_t crc;
} position_record_t;

enum { CALIBRATION_AT = 0, CALIBRATION_STRIDE = 768, POSITION_AT = 1536, POSITION_STRIDE = 64 };
_Static_assert(sizeof(calibration_record_t) <= CALIBRATION_STRIDE, "a copy has its place");
_Static_assert(sizeof(position_record_t) <= POSITION_STRIDE, "a copy has its place");
_Static_assert(POSITION_AT + 2 * POSITION_STRIDE <= FL_STORAGE_BYTES, "all have");

typedef struct place {
    uint32_t offset, stride, bytes; /* bytes: of the record, its crc last */
    uint32_t format;
} place_t;

static const place_t calibration_place = {CALIBRATION_AT, CALIBRATION_STRIDE, sizeof(calibration_record_t),
                                          CALIBRATION_FORMAT};
static const place_t position_place = {POSITION_AT, POSITION_STRIDE, sizeof(position_record_t),
                                       POSITION_FORMAT};

static uint32_t crc_of(const void *record, const place_t *at) {
    return fl_crc_end(fl_crc_add(FL_CRC_START, record, at->bytes - (uint32_t)sizeof(uint32_t)));
}

static uint32_t stored_crc(const void *record, const place_t *at) {
    const uint8_t *b = (const uint8_t *)record + at->bytes - sizeof(uint32_t);
    return b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24;
}

static bool read_copy(const fl_port_t *port, const place_t *at, uint32_t copy, void *record) {
    if (!port->storage_read) return false;
    if (port->storage_read(port->ctx, at->offset + copy * at->stride, record, at->bytes) != at->bytes)
        return false;
    return ((const header_t *)record)->format == at->format && stored_crc(record, at) == crc_of(record, at);
}

/* Sequence numbers wrap. */
static bool newer(uint32_t a, uint32_t b) { return (int32_t)(a - b) > 0; }

/* The newest good copy into `record` (two of them as room); -1 if there is none. */
static int read_newest(const fl_port_t *port, const place_t *at, void *record, void *other) {
    const bool first = read_copy(port, at, 0, record), second = read_copy(port, at, 1, other);
    if (!second) return first ? 0 : -1;
    if (first && newer(((const header_t *)record)->sequence, ((const header_t *)other)->sequence)) return 0;
    uint8_t *to = (uint8_t *)record;
    for (uint32_t i = 0; i < at->bytes; ++i) to[i] = ((const uint8_t *)other)[i];
    return 1;
}

/* Over the copy that does not count, and proven by reading it back. */
static bool write_next(const fl_port_t *port, const place_t *at, void *record, void *scratch) {
    if (!port->storage_write) return false;
    const int newest = read_newest(port, at, scratch, (uint8_t *)scratch + at->stride);
    header_t *header = (header_t *)record;
    header->format = at->format;
    header->sequence = newest < 0 ? 1 : ((const header_t *)scratch)->sequence + 1;
    const uint32_t copy = newest == 0 ? 1 : 0;
    const uint32_t crc = crc_of(record, at);
    uint8_t *tail = (uint8_t *)record + at->bytes - sizeof crc;
    for (int i = 0; i < 4; ++i) tail[i] = (uint8_t)(crc >> 8 * i);
    if (port->storage_write(port->ctx, at->offset + copy * at->stride, record, at->bytes) != at->bytes)
        return false;
    return read_copy(port, at, copy, scratch);
}

bool fl_storage_save(fl_positioner_t *p) {
    calibration_record_t r = {.trajectories = p->trajectories,
                              .hall_calibrated = p->hall_calibrated,
                              .cogging_calibrated = p->cogging_calibrated};
    for (int i = 0; i < FL_AXES; ++i) {
        r.params[i] = p->params[i];
        r.datum_ref_cnt[i] = p->axis[i].datum_ref_cnt;
        r.offset_cnt[i] = p->axis[i].offset_cnt;
        r.datum_calibrated |= (uint8_t)(p->axis[i].datum_calibrated << i);
    }
    /* two aligned records as room */
    uint32_t scratch[2 * CALIBRATION_STRIDE / sizeof(uint32_t)];
    return write_next(&p->port, &calibration_place, &r, scratch);
}

static void load_calibration(fl_positioner_t *p) {
    calibration_record_t r, other;
    if (read_newest(&p->port, &calibration_place, &r, &other) < 0) return;
    for (int i = 0; i < FL_AXES; ++i) {
        fl_axis_t *a = &p->axis[i];
        p->params[i] = r.params[i];
        fl_axis_configure(a, &p->params[i]);
        a->datum_ref_cnt = r.datum_ref_cnt[i];
        a->offset_cnt = r.offset_cnt[i];
        a->datum_calibrated = r.datum_calibrated >> i & 1;
    }
    p->trajectories = r.trajectories;
    p->hall_calibrated = r.hall_calibrated;
    p->cogging_calibrated = r.cogging_calibrated;
    p->options |= FL_STATUS(CALIBRATION_SAVED);
}

/* At rest the rotor cannot have turned far: its angle tells the rest of the turn. A position noted in
 * motion is a guess: the datum has to be found again. */
static void load_position(fl_positioner_t *p) {
    position_record_t r, other;
    if (read_newest(&p->port, &position_place, &r, &other) < 0) return;
    for (int i = 0; i < FL_AXES; ++i) {
        fl_axis_t *a = &p->axis[i];
        const int32_t rotor = fl_axis_look(a, &p->port, i);
        const int32_t moved = r.moving ? 0 : fl_fold_cnt(fl_sub_i32(rotor, r.rotor_cnt[i]));
        a->position_cnt = r.position_cnt[i];
        a->zero_cnt = fl_sub_i32(fl_add_i32(r.position_cnt[i], moved), rotor);
    }
    p->datum_known = r.moving ? 0 : r.datum_known;
    p->options |= r.moving ? FL_STATUS(ESTIMATED_POSITION) : FL_STATUS(POSITION_RESTORED);
}

void fl_storage_load(fl_positioner_t *p) {
    if (!p->port.storage_read) return;
    load_calibration(p);
    load_position(p);
}

/* Whether after a power cut now a position would be believed. */
static bool believes(const fl_port_t *port) {
    position_record_t r, other;
    return read_newest(port, &position_place, &r, &other) >= 0 && !r.moving;
}

static bool note(fl_positioner_t *p, position_record_t *r) {
    p->chores &= (uint8_t)~FL_CHORE_NOTE; /* an older one is overtaken */
    if (!p->port.storage_write || !p->port.storage_read) return true;
    uint32_t scratch[2 * POSITION_STRIDE / sizeof(uint32_t)];
    const bool noted = write_next(&p->port, &position_place, r, scratch);
    p->options &= ~FL_STATUS(STORAGE_FAILED);
    if (!noted) p->options |= FL_STATUS(STORAGE_FAILED);
    return noted || !believes(&p->port);
}

bool fl_storage_note_position(fl_positioner_t *p, bool moving) {
    position_record_t r = {.moving = moving, .datum_known = p->datum_known};
    for (int i = 0; i < FL_AXES; ++i) {
        r.position_cnt[i] = p->axis[i].position_cnt;
        r.rotor_cnt[i] = fl_sub_i32(r.position_cnt[i], p->axis[i].zero_cnt) & (FL_TURN_CNT - 1);
    }
    return note(p, &r);
}

bool fl_storage_declare_position(fl_positioner_t *p, const int32_t position_cnt[FL_AXES]) {
    position_record_t r = {.datum_known = FL_BOTH_AXES};
    for (int i = 0; i < FL_AXES; ++i) {
        r.position_cnt[i] = position_cnt[i];
        fl_axis_t *a = &p->axis[i];
        const int32_t fallen = fl_axis_fallen(a, &p->port, i);
        const int32_t rotor = fl_sub_i32(a->hall.angle_cnt, fl_positioner_settled(p, i) ? fallen : 0);
        r.rotor_cnt[i] = rotor & (FL_TURN_CNT - 1);
    }
    return note(p, &r);
}
