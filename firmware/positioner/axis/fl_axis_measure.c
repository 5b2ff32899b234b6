/* Legs that are there for what they measure. */
#include "fl_axis_parts.h"

/* The measured speed: noisy, but it knows where cogging slows the rotor, and sums forgive noise. */
static void measure_torque(fl_axis_t *a) {
    const float speed = (float)fl_sub_i32(a->hall.angle_cnt, a->calm_cnt) * FL_RAD_S_PER_CNT_TICK;
    const float driving = a->torque.torque_Nm - a->law.drive.servo.drag * speed;
    fl_friction_fit_add(&a->fit.friction, a->command.speed_rad_s < 0.0f, a->hall.angle_cnt, driving);
    a->calm_cnt = a->hall.angle_cnt;
}

FL_COLD void fl_axis_measure(fl_axis_t *a, uint8_t measures) {
    if (measures == FL_MEASURES_RANGE) fl_hall_fit_range(&a->fit.hall, a->adc_cnt);
    if (measures == FL_MEASURES_SHAPE) fl_hall_fit_add(&a->fit.hall, a->adc_cnt);
    if (measures == FL_MEASURES_TORQUE) measure_torque(a);
}

/* In every tick of the part, as the phases are set in every tick. */
static void coast_open(fl_axis_t *a, const fl_port_t *port, int index) {
    a->voltage = 0.0f;
    port->open_phases(port->ctx, index);
}

/* Eq. 20 without a loop. The field leads by what the rotor turned in the last tick, halved. */
FL_COLD void fl_axis_push_tick(fl_axis_t *a, const fl_port_t *port, int index) {
    const int second = a->wait.leg_ticks >= a->push.ticks[0];
    const bool over = a->wait.leg_ticks >= (uint32_t)a->push.ticks[0] + a->push.ticks[1];
    const float lead_rad = 0.5f * FL_RAD_PER_CNT * (float)fl_sub_i32(a->hall.angle_cnt, a->calm_cnt);
    a->calm_cnt = a->hall.angle_cnt;
    a->command.position_cnt = a->raw_cnt = a->position_cnt;
    ++a->wait.leg_ticks;
    if (over || !fl_axis_in_range(a, a->position_cnt)) {
        fl_axis_phases_off(a, port, index);
        fl_axis_next_leg(a);
        return;
    }
    if (a->push.voltage[second] == FL_TORQUE_OPEN) {
        coast_open(a, port, index);
        return;
    }
    a->voltage = (float)a->push.voltage[second] * (1.0f / 32767.0f);
    const fl_sincos_t rotor = fl_hall_vector(&a->law.hall, a->adc_cnt);
    const fl_duty_t duty = fl_commutate(a->voltage, rotor, fl_clamp(lead_rad, -0.2f, 0.2f));
    port->set_phases(port->ctx, index, duty.phase);
}
