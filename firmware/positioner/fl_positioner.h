/* A positioner: two axes, a supervisor and a CAN node, driven through the hardware port only. */
#ifndef FL_POSITIONER_H
#define FL_POSITIONER_H

#include <stdbool.h>
#include <stdint.h>

#include "fl_axis.h"
#include "fl_boot.h"
#include "fl_outbox.h"
#include "fl_params.h"
#include "fl_port.h"
#include "fl_supervisor.h"
#include "fl_trace.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { FL_BOTH_AXES = 3 }; /* as bits, alpha first */

/* What the end of a motion brings with it, in the order in which it is done. */
enum {
    FL_CHORE_RESULT_ALPHA = 1, /* of the calibration that has ended */
    FL_CHORE_RESULT_BETA = 2,
    FL_CHORE_NOTE = 4, /* the position, into the storage */
};

/* Visible, so that it can be placed, copied and inspected; only the functions below change it. */
typedef struct fl_positioner {
    fl_port_t port;
    uint16_t id;             /* 1..2047, bits 28..18 of the identifier */
    uint8_t state;           /* fl_state_t */
    uint8_t collided;        /* per axis, bit 0 = alpha: kept until STOP_TRAJECTORY */
    uint8_t hall_calibrated; /* likewise */
    uint8_t datum_known;
    uint8_t cogging_calibrated;
    bool path_bad;         /* a point was out of order or too fast */
    bool settings_changed; /* since the last save */
    bool led;              /* as commanded: no LED on the port */
    bool params_good;
    uint8_t chores;            /* FL_CHORE_...: one a tick, so that none of them takes long */
    uint32_t ticks;            /* since power-up */
    uint32_t heard_tick;       /* of the last request, or of the SYNC line */
    uint32_t host_watch_ticks; /* without one a trajectory ends; 0: never */
    fl_axis_t axis[FL_AXES];

    fl_outbox_t tx;
    uint64_t status;          /* what command 3 reports */
    uint64_t options;         /* status bits that are only remembered */
    uint16_t points[FL_AXES]; /* announced by SEND_NEW_TRAJECTORY */
    uint32_t trajectories;    /* started so far */
    fl_boot_t boot;
    fl_axis_params_t params[FL_AXES];
    fl_axis_params_t staged[FL_AXES]; /* written over the bus, not in force */
    bool staging;                     /* the copy was begun by a host that knows the table */
    fl_trace_t trace;                 /* bench: its samples lie in the paths */
    fl_path_t path[FL_AXES];
} fl_positioner_t;

/* From power-up to ready; reads what the storage holds. `params` are the factory parameters.
 * @pre 1 <= id <= 2047; read_hall works */
void fl_positioner_init(fl_positioner_t *p, const fl_port_t *port, uint16_t id,
                        const fl_axis_params_t params[FL_AXES]);

/* Into the bootloader, as at power-up of a real unit: it starts the main firmware after 10 s.
 * @pre after fl_positioner_init */
void fl_positioner_enter_bootloader(fl_positioner_t *p);

/* The control interrupt: call every FL_TICK_S. */
void fl_positioner_tick(fl_positioner_t *p);

/* The same in parts, for hosts that do the laws of many axes at once: begin, then for alpha and then for
 * beta whatever fl_axis_tick does, and fl_positioner_end_axis with what it returned. Begin returns false when
 * the tick is over. */
bool fl_positioner_begin_tick(fl_positioner_t *p);
/* The end of an axis' tick, with what fl_axis_tick returned.
 * @pre fl_positioner_begin_tick has returned true in this tick */
void fl_positioner_end_axis(fl_positioner_t *p, int axis, fl_axis_event_t event);

/* True when ticks change nothing but time: no move, phases off, nothing queued. A simulator may then
 * leave ticks out; fl_positioner_skip tells how many. */
bool fl_positioner_at_rest(const fl_positioner_t *p);
/* Time passes without ticks.
 * @pre fl_positioner_at_rest; or a host does the ticks of the axes itself (fl_axis_tracks), and begin_tick
 *      would do nothing in them but count */
void fl_positioner_skip(fl_positioner_t *p, uint32_t ticks);

/* Whether the position of an axis is the one at which it came to rest, so that another one that is declared
 * takes its place: its datum is known, or it was restored. */
bool fl_positioner_settled(const fl_positioner_t *p, int axis);

/* Declares where the axes are (output angle in 2^30 per turn) and that datums are set. False and no
 * change where the storage does not take it and would bring back an older position.
 * @pre both axes rest */
bool fl_positioner_set_position(fl_positioner_t *p, const int32_t position_cnt[FL_AXES]);

/* Replaces the parameters of an axis. False and no change while it moves. */
bool fl_positioner_set_params(fl_positioner_t *p, int axis, const fl_axis_params_t *params);

/* A command was carried out: the supervisor's next state (fl_state_t), with all that follows. False where a
 * motion would begin that cannot be noted, so that a power cut would bring back the position from before:
 * nothing moves then, and what is loaded is dropped. */
bool fl_positioner_enter(fl_positioner_t *p, uint8_t state);

/* Forgets the trajectories. */
void fl_positioner_drop_paths(fl_positioner_t *p);

/* An event from inside moves the supervisor on. */
void fl_positioner_apply(fl_positioner_t *p, fl_input_t input);

/* Both axes: phases off; they coast to a standstill. */
void fl_positioner_brake(fl_positioner_t *p);

/* For logs and the scope of a bench: what the control law saw and did in the last tick. */
typedef struct fl_axis_telemetry {
    float command_deg;  /* motor angle asked for, relative to the turn counter's zero, folded to the
                         * last 2^24 of a degree: use differences to measured_deg */
    float tracking_deg; /* commanded minus measured motor angle */
    float speed_rad_s;  /* commanded */
    float feedback_Nm;  /* PI term, the one Eq. 22 watches */
    float feedforward_Nm;
    float voltage;  /* u_cmd / u_dc */
    float load_Nm;  /* beyond its mean, as the touch watch sees it; resisting is positive */
    float touch_Nm; /* where it is a touch */
} fl_axis_telemetry_t;
/* The last tick of an axis (FL_ALPHA or FL_BETA). */
fl_axis_telemetry_t fl_positioner_telemetry(const fl_positioner_t *p, int axis);

/* Position in 2^30 per output turn: measured in motion; at rest where the last move settled, for that
 * is where the gear is (without current the rotor may fall back inside the backlash). */
int32_t fl_positioner_position(const fl_positioner_t *p, int axis);

#ifdef __cplusplus
}
#endif
#endif
