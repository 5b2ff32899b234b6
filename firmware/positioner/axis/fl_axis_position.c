/* Where an axis is, and how far it may go. */
#include "fl_axis_parts.h"

__attribute__((noinline)) fl_hall_out_t fl_axis_sense(fl_axis_t *a, const fl_port_t *port, int index) {
    port->read_hall(port->ctx, index, a->adc_cnt);
    return fl_hall_step(&a->law.hall, &a->hall, a->adc_cnt);
}

int32_t fl_axis_look(fl_axis_t *a, const fl_port_t *port, int index) {
    return fl_axis_sense(a, port, index).angle_cnt;
}

int32_t fl_axis_datum_cnt(const fl_axis_t *a) { return fl_add_i32(a->law.datum_cnt, a->offset_cnt); }

static void declare(fl_axis_t *a, int32_t position_cnt) {
    a->zero_cnt = fl_sub_i32(position_cnt, a->hall.angle_cnt);
    a->position_cnt = a->command.position_cnt = position_cnt;
}

int32_t fl_axis_fallen(fl_axis_t *a, const fl_port_t *port, int index) {
    return fl_sub_i32(fl_add_i32(fl_axis_look(a, port, index), a->zero_cnt), a->position_cnt);
}

void fl_axis_set_position(fl_axis_t *a, const fl_port_t *port, int index, int32_t position_cnt,
                          bool settled) {
    const int32_t fallen = fl_axis_fallen(a, port, index);
    declare(a, position_cnt);
    if (settled) a->zero_cnt = fl_add_i32(a->zero_cnt, fallen);
    a->datum_ref_cnt = fl_sub_i32(fl_axis_datum_cnt(a), a->zero_cnt) & (FL_TURN_CNT - 1);
    a->datum_calibrated = true;
}

/* The datum is the calibrated rotor angle nearest to where the axis came to stand, so that it does
 * not depend on how hard the stop was pressed. */
void fl_axis_declare_datum(fl_axis_t *a) {
    if (a->datum_calibrate) {
        a->datum_ref_cnt = a->hall.angle_cnt & (FL_TURN_CNT - 1);
        a->datum_calibrated = true;
    }
    a->datum_found = true;
    const int32_t past = fl_fold_cnt(fl_sub_i32(a->hall.angle_cnt, a->datum_ref_cnt));
    declare(a, fl_add_i32(fl_axis_datum_cnt(a), past));
}

bool fl_axis_in_range(const fl_axis_t *a, int32_t position_cnt) {
    /* the limits are rounded to float32: a thousandth of a degree of grace */
    const int32_t grace = 2983;
    return position_cnt >= fl_sub_i32(a->law.position_min_cnt, grace) &&
           position_cnt <= fl_add_i32(a->law.position_max_cnt, grace);
}

/* Go-to moves reach their speed within 0.25 s at the latest: jaeger's estimate of their duration. */
fl_profile_limits_t fl_axis_goto_limits(const fl_axis_t *a) {
    const float speed = (float)a->speed_rpm * FL_CNT_TICK_PER_RPM;
    const fl_profile_limits_t lim = {
        speed, fl_max(a->law.acceleration_cnt_tick2, speed * (1.0f / (0.25f * FL_TICK_HZ)))};
    return lim;
}

static uint32_t way_ticks(const fl_axis_t *a, int32_t way_cnt) {
    const float speed = (float)a->speed_rpm * FL_CNT_TICK_PER_RPM;
    return (uint32_t)(fl_abs((float)way_cnt) / speed) + FL_TICK_HZ / 4;
}

uint32_t fl_axis_goto_ticks(const fl_axis_t *a, int32_t target_cnt) {
    const int32_t way = fl_sub_i32(target_cnt, a->position_cnt);
    if (!a->precise) return way_ticks(a, way);
    return way_ticks(a, fl_add_i32(way, a->law.approach_cnt)) + way_ticks(a, a->law.approach_cnt);
}
