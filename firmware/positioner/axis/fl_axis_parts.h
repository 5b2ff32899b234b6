/* What the files of an axis share. Nothing outside this folder includes it. */
#ifndef FL_AXIS_PARTS_H
#define FL_AXIS_PARTS_H

#include "fl_axis.h"

/* Seldom done inside a tick: kept apart, so that the compiler does not shape the rest around it. Loads
 * of both hall channels at once, which copies invite, would wait for the two stores of read_hall. */
#define FL_COLD __attribute__((noinline, cold))

/* The traits of the present leg.
 * @pre !fl_axis_rests(a) */
static inline fl_leg_traits_t fl_axis_leg(const fl_axis_t *a) { return fl_leg_traits[a->plan[a->leg].kind]; }

/* -- fl_axis_leg.c */

/* The plan's first tick: from where the rotor is. */
void fl_axis_begin(fl_axis_t *a);
/* On to the next leg of the plan. */
void fl_axis_next_leg(fl_axis_t *a);
/* No plan. */
void fl_axis_clear_plan(fl_axis_t *a);
/* One leg more at the end of the plan, to a position in counts.
 * @pre a->legs < FL_PLAN_LEGS */
void fl_axis_add_leg(fl_axis_t *a, fl_leg_kind_t kind, int32_t target_cnt);

/* -- fl_axis_plan.c */

/* Slowed down to a standstill: what is left of the plan is to land and settle here.
 * @pre a->leg <= FL_PLAN_LEGS - 3 */
void fl_axis_stop_here(fl_axis_t *a);
/* The coils brake; the plan stays. */
void fl_axis_phases_off(fl_axis_t *a, const fl_port_t *port, int index);

/* -- fl_axis_position.c */

/* Reads the sensors and unwraps the rotor angle. */
fl_hall_out_t fl_axis_sense(fl_axis_t *a, const fl_port_t *port, int index);
/* Where the datum is, counts of position. */
int32_t fl_axis_datum_cnt(const fl_axis_t *a);
/* The datum is where the rotor is now. */
void fl_axis_declare_datum(fl_axis_t *a);
/* Limits of a go-to move. */
fl_profile_limits_t fl_axis_goto_limits(const fl_axis_t *a);

/* -- fl_axis_measure.c */

/* What a calibrating leg takes from a tick (fl_leg_measures_t).
 * @pre the sensors have been read and the drive has done its tick */
void fl_axis_measure(fl_axis_t *a, uint8_t measures);
/* A tick of a push.
 * @pre the sensors have been read */
void fl_axis_push_tick(fl_axis_t *a, const fl_port_t *port, int index);

#endif
