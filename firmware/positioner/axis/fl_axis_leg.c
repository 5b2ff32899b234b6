/* From leg to leg of a plan. */
#include "fl_axis_parts.h"

const fl_leg_traits_t fl_leg_traits[FL_LEG_KINDS] = {
#define X(kind, does, step, measures, traits)                                                                \
    {FL_DOES_##does, FL_STEP_##step, FL_MEASURES_##measures, traits},
    FL_LEGS(X)
#undef X
};

void fl_axis_clear_plan(fl_axis_t *a) {
    a->leg = a->legs = 0;
    a->wait.leg_ticks = a->wait.calm_ticks = 0;
    a->fresh = true;
    a->slowing = false;
}

void fl_axis_add_leg(fl_axis_t *a, fl_leg_kind_t kind, int32_t target_cnt) {
    a->plan[a->legs++] = (fl_leg_t){target_cnt, (uint8_t)kind};
}

__attribute__((noinline)) static void enter(fl_axis_t *a) {
    a->wait.leg_ticks = a->wait.calm_ticks = 0;
    a->wait.lag_cnt = 0;
    a->calm_cnt = a->hall.angle_cnt;
    if (fl_axis_rests(a)) return;
    const uint8_t step = fl_axis_leg(a).step;
    if (step == FL_STEP_PROFILE)
        fl_profile_start(&a->profile, a->raw_cnt, a->plan[a->leg].target_cnt, fl_axis_goto_limits(a));
    /* what the integral made up for in motion is gone at standstill */
    if (step == FL_STEP_LAND) a->drive.servo.integral_Nm = 0.0f;
    if (step == FL_STEP_PATH) fl_path_start(&a->cursor, a->raw_cnt);
}

void fl_axis_next_leg(fl_axis_t *a) {
    ++a->leg;
    enter(a);
}

/* Without a jump. */
FL_COLD void fl_axis_begin(fl_axis_t *a) {
    a->raw_cnt = a->position_cnt;
    fl_smooth_reset(&a->smooth, a->raw_cnt);
    a->drive.servo.integral_Nm = a->drive.servo.direction = 0.0f;
    a->drive.regulator = (fl_regulator_state_t){{0.0f, 0.0f, 0.0f}, 0.0f};
    const fl_touch_state_t *t = &a->drive.touch;
    a->drive.touch = (fl_touch_state_t){.scatter_Nm = t->scatter_Nm,
                                        .dip_Nm = t->dip_Nm,
                                        .share = t->share,
                                        .sure = t->sure,
                                        .ripple = t->ripple};
    a->fresh = false;
    a->start_cnt = a->position_cnt;
    for (int i = 0; i < 2; ++i) a->start_adc_cnt[i] = a->adc_cnt[i];
    enter(a);
}
