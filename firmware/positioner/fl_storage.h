/* What outlives a power cut: calibrations in two copies, the position in two alternating records.
 *
 * Every record carries a sequence number and a CRC-32; the newest good one counts and the other one
 * is overwritten, so a write cut short at any byte loses nothing that was there before.
 */
#ifndef FL_STORAGE_H
#define FL_STORAGE_H

#include "fl_positioner.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Bytes a port should have; with less (or none) settings are simply not kept. */
#define FL_STORAGE_BYTES 2048

/* Reads calibrations and position, as far as there are good ones.
 * @pre the axes are initialised with the factory parameters */
void fl_storage_load(fl_positioner_t *p);

/* Saves the calibrations; false when the storage did not take them: the last saved ones then still count. */
bool fl_storage_save(fl_positioner_t *p);

/* Notes the position, at the start (moving) and the end of every motion. False: the storage did not take it,
 * and after a power cut an older position at rest would be believed: then nothing may move. Sets or clears
 * STORAGE_FAILED. */
bool fl_storage_note_position(fl_positioner_t *p, bool moving);

/* The same for positions that are about to be declared, with both datums known. */
bool fl_storage_declare_position(fl_positioner_t *p, const int32_t position_cnt[FL_AXES]);

#ifdef __cplusplus
}
#endif

#endif
