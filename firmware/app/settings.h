// SPDX-License-Identifier: MIT
// The parameters kept over a reset: a log of whole sets in two pages of a memory that forgets only by pages.
//
// A set is a record in a slot of its own: what and whose it is, a sequence number, the values, and at the end a CRC-32
// of it all. Sets are appended; when a page is full the other one is erased and the log goes on there. So whatever a
// power cut leaves half done is the newest set or a page without the newest one: the set before stays whole, and
// loading takes the newest that is whole. A slot in which anything was programmed is never programmed again before
// its page is erased.
#ifndef OMNIBOT_APP_SETTINGS_H
#define OMNIBOT_APP_SETTINGS_H

#include "parameters.h"

#include <stdbool.h>
#include <stdint.h>

/// A slot is larger than a set, and the same whatever the table: sets of another firmware are still found and told
/// from damage.
enum { SETTINGS_PAGES = 2, SETTINGS_SLOT_BYTES = 256 };

/// The port's memory. An erased byte is 0xFF; programming may clear bits only, in whole words of four bytes. Every call
/// has a bounded time and returns false if it failed; `page` is 0 or 1, `offset` counts from the page's beginning.
typedef struct {
    void *context;       // given back in each call
    uint32_t page_bytes; // a multiple of SETTINGS_SLOT_BYTES, the same for both pages
    bool (*read)(void *context, uint8_t page, uint32_t offset, uint8_t *bytes, uint32_t length);
    bool (*erase)(void *context, uint8_t page);
    bool (*program)(void *context, uint8_t page, uint32_t offset, const uint8_t *bytes, uint32_t length);
} settings_memory_t;

typedef enum {
    SETTINGS_OK,    // the newest whole set
    SETTINGS_EMPTY, // nothing was ever kept: defaults
    SETTINGS_LOST   // something is there but no set for this firmware, or it can't be read: defaults, to be reported
} settings_result_t;

/// Gives the set that is held, or the defaults. Reads both pages once.
settings_result_t settings_load(const settings_memory_t *memory, parameters_t *parameters);

/// Keeps a set. True when it can be read back whole; programs nothing when it is held already. Reads both pages once,
/// programs one record, and erases a page when the other is full.
bool settings_save(const settings_memory_t *memory, const parameters_t *parameters);

#endif
