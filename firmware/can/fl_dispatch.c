/* One reply for one request, always; the order of the checks is the order of the codes in doubt:
 * unknown, broadcast, length, state (the supervisor's table), value (the handler). */
#include "fl_dispatch.h"

#include "fl_commands.h"
#include "fl_identifier.h"
#include "fl_status.h"

/* Not inlined: a handler runs without this frame on its stack.
 * @pre there is room, or the request stops */
__attribute__((noinline)) static void reply(fl_positioner_t *p, const fl_can_frame_t *request, fl_code_t code,
                                            const fl_reply_t *re) {
    const fl_identifier_t asked = fl_identifier_unpack(request->id);
    const fl_identifier_t id = {p->id, asked.command, asked.uid, (uint8_t)code};
    fl_can_frame_t f = {.id = fl_identifier_pack(id), .len = code == FL_ACCEPTED ? re->len : 0};
    for (int i = 0; i < 8; ++i) f.data[i] = re->data[i];
    if (fl_outbox_full(&p->tx))
        fl_outbox_put_urgent(&p->tx, &p->port, FL_URGENT_STOP, &f);
    else
        fl_outbox_put(&p->tx, &p->port, &f);
}

static fl_code_t execute(fl_positioner_t *p, const fl_command_row_t *row, const fl_can_frame_t *f,
                         fl_reply_t *re) {
    const fl_input_t input = (fl_input_t)row->input;
    const fl_verdict_t verdict =
        fl_supervisor_match((fl_state_t)p->state, input, fl_status_conditions(p, row->axes));
    if (verdict.code != FL_ACCEPTED) return (fl_code_t)verdict.code;
    const fl_request_t rq = {f->data, f->len, row->axes, row->arg, row->input};
    const fl_code_t code = row->handler(p, &rq, re);
    if (code != FL_ACCEPTED || input == FL_IN_QUERY) return code;
    return fl_positioner_enter(p, verdict.next) ? FL_ACCEPTED : FL_INVALID_COMMAND;
}

static fl_code_t answer(fl_positioner_t *p, fl_identifier_t id, const fl_can_frame_t *f, fl_reply_t *re) {
    const fl_command_row_t *row = fl_command_find(id.command);
    const bool boot = p->state == FL_STATE_BOOTLOADER;
    if (!row) return FL_UNKNOWN_COMMAND;
    if (boot && !(row->flags & FL_CMD_BOOTLOADER)) return FL_INVALID_BOOTLOADER_COMMAND;
    if (id.positioner == 0 && !(row->flags & FL_CMD_BROADCAST)) return FL_INVALID_BROADCAST_COMMAND;
    if (f->len < row->len_min || f->len > row->len_max) return FL_INCORRECT_AMOUNT_OF_DATA;
    return execute(p, row, f, re);
}

static bool stops(uint8_t command) {
    const fl_command_row_t *row = fl_command_find(command);
    return row && row->input == FL_IN_STOP;
}

void fl_positioner_receive(fl_positioner_t *p, const fl_can_frame_t *frame) {
    const fl_identifier_t id = fl_identifier_unpack(frame->id);
    if (frame->id >> 29 != 0 || frame->len > 8) return;
    if (id.positioner != 0 && id.positioner != p->id) return;
    /* a code makes it a reply: two units with one number would answer each other without end */
    if (id.code != 0) return;
    p->heard_tick = p->ticks;
    /* without room for the answer the request is not carried out either, but for a stop */
    fl_outbox_flush(&p->tx, &p->port);
    if (fl_outbox_full(&p->tx) && !stops(id.command)) return;
    fl_reply_t re = {{0}, 0};
    const fl_code_t code = answer(p, id, frame, &re);
    reply(p, frame, code, &re);
}
