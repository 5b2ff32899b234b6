/* Trajectories: points in six bytes each, followed along straight lines in integers.
 *
 * A slot holds a position (32 bits) and the ticks since the slot before (16 bits). Zero ticks marks
 * a slot whose 32 bits are extra ticks of the next point: only gaps over 32.7 s need one. Time
 * starts at -1, so that a first point at tick 0 has one tick.
 */
#ifndef FL_PATH_H
#define FL_PATH_H

#include "fl_math.h"

#define FL_PATH_POINTS 1000 /* per axis, whatever their gaps up to 32.7 s */
#define FL_PATH_SLOTS 1024  /* so at least 24 longer gaps beside 1000 points */

typedef struct fl_path {
    uint16_t slot[FL_PATH_SLOTS][3]; /* position low, position high, ticks */
    uint16_t slots;
    uint16_t points;
    uint16_t plateau_slot; /* from here on all positions equal the last */
    int32_t last_cnt;
    int32_t last_tick;
    int32_t landing_cnt; /* taken off the plateau, for the firmware to creep */
} fl_path_t;

typedef struct fl_path_cursor {
    int32_t position_cnt;
    int32_t step_cnt, rest, rest_sum; /* whole counts per tick, and the division's remainder */
    uint32_t ticks_left, ticks;
    uint16_t slot;
} fl_path_cursor_t;

/* No points. */
static inline void fl_path_clear(fl_path_t *path) {
    path->slots = path->points = path->plateau_slot = 0;
    path->last_cnt = 0;
    path->last_tick = -1;
    path->landing_cnt = 0;
}

/* Writes a slot: 32 bits of value, 16 bits of ticks.
 * @pre path->slots < FL_PATH_SLOTS */
static inline void fl_path_put(fl_path_t *path, uint32_t value, uint32_t ticks) {
    uint16_t *slot = path->slot[path->slots++];
    slot[0] = (uint16_t)value;
    slot[1] = (uint16_t)(value >> 16);
    slot[2] = (uint16_t)ticks;
}

/* Appends a point; false when its time does not grow or the memory is full. */
static inline bool fl_path_append(fl_path_t *path, int32_t position_cnt, int32_t tick) {
    if (tick <= path->last_tick) return false;
    const uint32_t gap = (uint32_t)tick - (uint32_t)path->last_tick;
    const bool is_long = gap > UINT16_MAX;
    if (path->slots + (is_long ? 2 : 1) > FL_PATH_SLOTS) return false;
    if (path->points == 0 || position_cnt != path->last_cnt) path->plateau_slot = path->slots;
    if (is_long) fl_path_put(path, gap - UINT16_MAX, 0);
    fl_path_put(path, (uint32_t)position_cnt, is_long ? UINT16_MAX : gap);
    ++path->points;
    path->last_cnt = position_cnt;
    path->last_tick = tick;
    return true;
}

/* The 32 bits of a slot.
 * @pre slot < path->slots */
static inline uint32_t fl_path_value(const fl_path_t *path, uint16_t slot) {
    return path->slot[slot][0] | (uint32_t)path->slot[slot][1] << 16;
}

/* Ticks from the point before to the one whose slots begin here, and where that one is. */
static inline uint16_t fl_path_read(const fl_path_t *path, uint16_t slot, int32_t *position_cnt,
                                    uint32_t *ticks) {
    uint32_t extra = 0;
    if (path->slot[slot][2] == 0) extra = fl_path_value(path, slot++);
    *position_cnt = (int32_t)fl_path_value(path, slot);
    *ticks = extra + path->slot[slot][2];
    return (uint16_t)(slot + 1);
}

/* Slope of the segment to the point at cursor->slot as quotient and remainder, so that the end is
 * met exactly. Once a segment; 32-bit division. */
static inline void fl_path_enter(const fl_path_t *path, fl_path_cursor_t *cur) {
    const uint16_t begin = cur->slot;
    int32_t to_cnt;
    uint32_t ticks;
    cur->slot = fl_path_read(path, begin, &to_cnt, &ticks);
    if (begin >= path->plateau_slot) to_cnt = fl_sub_i32(to_cnt, path->landing_cnt);
    const int32_t way = fl_sub_i32(to_cnt, cur->position_cnt);
    const uint32_t magnitude = way < 0 ? 0u - (uint32_t)way : (uint32_t)way;
    const int32_t step = (int32_t)(magnitude / ticks);
    const int32_t rest = (int32_t)(magnitude % ticks);
    cur->step_cnt = way < 0 ? -step : step;
    cur->rest = way < 0 ? -rest : rest;
    cur->rest_sum = 0;
    cur->ticks = cur->ticks_left = ticks;
}

/* Begins at the first point, coming from position here_cnt. */
static inline void fl_path_start(fl_path_cursor_t *cur, int32_t here_cnt) {
    cur->position_cnt = here_cnt;
    cur->slot = 0;
    cur->ticks_left = 0;
    cur->step_cnt = cur->rest = cur->rest_sum = 0;
    cur->ticks = 1;
}

/* Whether the last point is reached. */
static inline bool fl_path_done(const fl_path_t *path, const fl_path_cursor_t *cur) {
    return cur->ticks_left == 0 && cur->slot >= path->slots;
}

/* One tick along a segment.
 * @pre cur->ticks_left > 0 */
static inline void fl_path_go(fl_path_cursor_t *cur) {
    --cur->ticks_left;
    cur->position_cnt = fl_add_i32(cur->position_cnt, cur->step_cnt);
    cur->rest_sum += cur->rest;
    if (cur->rest_sum >= (int32_t)cur->ticks) {
        ++cur->position_cnt;
        cur->rest_sum -= (int32_t)cur->ticks;
    } else if (cur->rest_sum <= -(int32_t)cur->ticks) {
        --cur->position_cnt;
        cur->rest_sum += (int32_t)cur->ticks;
    }
}

/* Position at the end of the next tick. */
static inline int32_t fl_path_step(const fl_path_t *path, fl_path_cursor_t *cur) {
    if (cur->ticks_left == 0) {
        if (cur->slot >= path->slots) return cur->position_cnt;
        fl_path_enter(path, cur);
    }
    fl_path_go(cur);
    return cur->position_cnt;
}

#endif
