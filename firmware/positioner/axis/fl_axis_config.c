/* From parameters to the constants of the laws: every division happens here. */
#include "fl_axis.h"

static fl_sincos_t sincos_rad(float angle_rad) {
    return fl_sincos_cnt(fl_round_i32(angle_rad * FL_CNT_PER_RAD));
}

static fl_hall_config_t hall_config(const fl_axis_params_t *p) {
    const fl_sincos_t phase = sincos_rad(p->hall_phase);
    const fl_hall_config_t cfg = {p->hall_offset_a,           p->hall_offset_b, 1.0f / p->hall_amplitude_a,
                                  1.0f / p->hall_amplitude_b, 1.0f / phase.cos, phase.sin / phase.cos};
    return cfg;
}

/* So that a feedback torque t at 2000 rpm adds t/T_learn per second to the drag torque. */
static float drag_learning(const fl_axis_params_t *p) {
    const float drag = p->use_speed * p->drag;
    if (!(drag > 0.0f && p->drag_learning_time > 0.0f)) return 0.0f;
    return 1.0f / (p->drag_learning_time * drag * (FL_LEARNING_RAD_S * FL_LEARNING_RAD_S));
}

static int32_t phase_cnt(float phase_rad) { return fl_round_i32(phase_rad * FL_CNT_PER_RAD); }

static fl_servo_config_t servo_config(const fl_axis_params_t *p) {
    const float ba = p->use_break_away;
    const fl_servo_config_t cfg = {
        .k_p = p->k_p,
        .k_i = p->k_i,
        .settle_gain = p->settle_gain,
        .integral_limit = p->integral_limit,
        .drag = p->use_speed * p->drag,
        .learning = drag_learning(p),
        .doubting = 0.5f * p->drag * drag_learning(p),
        .inertia = p->use_inertia * p->inertia,
        .coulomb = ba * p->coulomb,
        .spring_torque = ba * p->spring_torque,
        .spring_rate = ba * p->spring_rate,
        .cogging = ba * p->cogging_torque,
        .cogging_phase_cnt = phase_cnt(p->cogging_phase),
    };
    return cfg;
}

/* Eq. 23, lower bound, in counts; without a gain nothing is ever too far. */
static fl_collision_config_t collision_config(const fl_axis_params_t *p, float margin_rad) {
    const float threshold = fl_max(p->collision_torque + p->k_p * margin_rad, 0.0f);
    const float error_rad = (threshold - p->integral_limit) / fl_max(p->k_p, 1e-12f);
    const float error_cnt = fl_clamp(error_rad * FL_CNT_PER_RAD, 0.0f, 1e9f);
    const fl_collision_config_t cfg = {
        .threshold_Nm = threshold,
        .contact_Nm = p->contact_torque > 0.0f ? p->contact_torque + p->k_p * margin_rad : 1e9f,
        .drag = p->drag,
        .drag_share = p->collision_speed_share,
        .error_min_cnt = (int32_t)error_cnt,
    };
    return cfg;
}

/* Without a part of the feedforward every load is beyond the model: nothing to be told from it. */
static fl_touch_config_t touch_config(const fl_axis_params_t *p, float margin_rad) {
    const bool whole = p->use_break_away * p->use_speed * p->use_inertia == 1.0f;
    const float wider_Nm = p->k_p * fl_max(margin_rad, 0.0f);
    const fl_observer_gains_t gains = fl_touch_gains(p->drag / p->inertia);
    const fl_touch_config_t cfg = {
        .inertia = p->inertia,
        .inertia_inverse = 1.0f / p->inertia,
        .drag = p->drag,
        .gain_e = gains.e,
        .gain_v = gains.v,
        .gain_a = gains.a,
        .doubt_Nms = FL_TOUCH_DOUBT * p->drag,
        .surge_kg_m2 = FL_TOUCH_INERTIA * p->inertia,
        .threshold_Nm = whole && p->touch_torque > 0.0f ? p->touch_torque + wider_Nm : 1e9f,
    };
    return cfg;
}

static fl_teeth_config_t teeth_config(const fl_axis_params_t *p) {
    const fl_teeth_config_t cfg = {
        .mean_cnt = p->backlash * FL_CNT_PER_MOTOR_DEG,
        .once_cnt = p->backlash_1 * FL_CNT_PER_MOTOR_DEG,
        .twice_cnt = p->backlash_2 * FL_CNT_PER_MOTOR_DEG,
        .thrice_cnt = p->backlash_3 * FL_CNT_PER_MOTOR_DEG,
        .pairing_cnt = p->backlash_teeth * FL_CNT_PER_MOTOR_DEG,
        .once_phase_cnt = phase_cnt(p->backlash_1_phase),
        .twice_phase_cnt = phase_cnt(p->backlash_2_phase),
        .thrice_phase_cnt = phase_cnt(p->backlash_3_phase),
        .pairing_phase_cnt = phase_cnt(p->backlash_teeth_phase),
        .pairings = fl_round_i32(p->gear_teeth),
    };
    return cfg;
}

static fl_regulator_config_t regulator_config(const fl_axis_params_t *p) {
    const fl_observer_gains_t gains = fl_observer_gains(p->observer_pole);
    const fl_regulator_config_t cfg = {
        .k_e = p->state_k_e,
        .k_v = p->state_k_v,
        .gain_e = gains.e,
        .gain_v = gains.v,
        .gain_a = gains.a,
        .inertia = p->inertia,
        .inertia_inverse = 1.0f / p->inertia,
        .drag = p->drag,
        .gap_coulomb = p->use_break_away * p->coulomb * p->gap_coulomb_share,
        .gap_drag = p->use_speed * p->drag * p->gap_drag_share,
    };
    return cfg;
}

static fl_drive_config_t drive_config(const fl_axis_params_t *p, float margin_rad) {
    const float full_Nm = p->torque_per_volt * p->u_dc;
    const fl_drive_config_t cfg = {
        .servo = servo_config(p),
        .collision = collision_config(p, margin_rad),
        .touch = touch_config(p, margin_rad),
        .teeth = teeth_config(p),
        .regulator = regulator_config(p),
        .voltage_per_Nm = 1.0f / full_Nm,
        .full_Nm = full_Nm,
        .law = p->law >= 0.5f ? FL_LAW_CONTACT : FL_LAW_PAPER,
    };
    return cfg;
}

static int32_t motor_deg(float deg) { return fl_round_i32(deg * FL_CNT_PER_MOTOR_DEG); }

/* Output degrees, kept inside 32 bits. */
static int32_t output_deg(float deg) {
    return fl_round_i32(fl_clamp(deg * FL_CNT_PER_OUTPUT_DEG, -2147483520.0f, 2147483520.0f));
}

static uint32_t ticks(float s) { return (uint32_t)(s * (float)FL_TICK_HZ + 0.5f); }

/* The way from one limit to the other and 30 degrees more: then nothing is there to be found. */
static uint32_t search_ticks(const fl_axis_params_t *p) {
    const float way_cnt = (p->position_max - p->position_min + 30.0f) * FL_CNT_PER_OUTPUT_DEG;
    return (uint32_t)(way_cnt / (p->datum_speed * FL_CNT_TICK_PER_RPM));
}

void fl_axis_configure(fl_axis_t *a, const fl_axis_params_t *p) {
    const float per_tick = FL_CNT_PER_MOTOR_DEG * FL_TICK_S;
    const fl_axis_law_t law = {
        .hall = hall_config(p),
        .drive = drive_config(p, a->margin_rad),
        .open_loop_voltage = p->open_loop_voltage,
        .holding_voltage = p->holding_voltage,
        .acceleration_cnt_tick2 = p->acceleration * FL_CNT_TICK2_PER_RAD_S2,
        .datum_step_cnt = 1 + (int32_t)(p->datum_speed * FL_CNT_TICK_PER_RPM),
        .search_ticks = search_ticks(p),
        .approach_cnt = motor_deg(p->approach),
        .landing_cnt = motor_deg(p->landing),
        .landing_step_cnt = 1 + (int32_t)(p->landing_speed * per_tick),
        .tolerance_cnt = motor_deg(p->settle_tolerance),
        .settle_ticks = ticks(p->settle_time),
        .timeout_ticks = ticks(p->settle_timeout),
        .position_min_cnt = output_deg(p->position_min),
        .position_max_cnt = output_deg(p->position_max),
        .datum_cnt = output_deg(p->datum_position),
        .speed_max_cnt_tick = (uint32_t)(p->speed_max * FL_CNT_TICK_PER_RPM),
    };
    a->law = law;
}

void fl_axis_unlearn_touch(fl_axis_t *a, const fl_axis_params_t *p) {
    a->drive.touch = (fl_touch_state_t){.scatter_Nm = FL_TOUCH_SCATTER_FIRST * p->touch_torque,
                                        .share = FL_TOUCH_SHARE_FIRST};
}

void fl_axis_unlearn(fl_axis_t *a, const fl_axis_params_t *p) {
    a->drive.servo = (fl_servo_state_t){0.0f, 0.0f, FL_DOUBT_FIRST, 1.0f};
    fl_axis_unlearn_touch(a, p);
    a->drive.teeth = (fl_teeth_state_t){0, 0, 0};
    a->drive.regulator = (fl_regulator_state_t){{0.0f, 0.0f, 0.0f}, 0.0f};
}

void fl_axis_init(fl_axis_t *a, const fl_axis_params_t *p) {
    a->margin_rad = 0.0f;
    a->hall_error_mdeg = 0;
    fl_axis_configure(a, p);
    fl_axis_unlearn(a, p);
    a->hall = (fl_hall_state_t){0, false};
    a->leg = a->legs = 0;
    a->slowing = false;
    a->slow = (fl_slow_t){0, 0, 0, 0};
    a->closed_loop = a->detect = true;
    a->precise = a->datum_calibrated = a->datum_found = a->datum_calibrate = false;
    a->zero_cnt = a->datum_ref_cnt = a->offset_cnt = a->position_cnt = a->raw_cnt = a->start_cnt =
        a->wait.lag_cnt = a->calm_cnt = 0;
    a->speed_rpm = (uint32_t)p->speed_default;
    a->command = (fl_command_t){0, 0.0f, 0.0f};
    a->torque = (fl_servo_out_t){0.0f, 0.0f, 0.0f};
    a->voltage = 0.0f;
    a->push = (fl_torque_step_t){{0, 0}, {0, 0}};
}
