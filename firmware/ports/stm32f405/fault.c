// SPDX-License-Identifier: MIT
#include "fault.h"

#include "crc.h"

#include <stddef.h>
#include <string.h>

#define MAGIC 0x6F6D6E69u // "omni"
#define ICSR_VECTACTIVE 0x1FFu

static uint32_t crc_of(const crash_facts_t *facts)
{
    uint8_t byte[sizeof *facts];
    (void)memcpy(byte, facts, sizeof byte);
    uint32_t crc = CRC32_START;
    for (uint32_t i = 0; i < sizeof byte; i++) {
        crc = crc32_update(crc, byte[i]);
    }
    return crc32_finish(crc);
}

void crash_record(crash_t *crash, const scb_registers_t *core, const exception_frame_t *frame)
{
    crash->facts = (crash_facts_t){
        .magic = MAGIC,
        .exception = reg_read(&core->icsr) & ICSR_VECTACTIVE,
        .pc = frame != NULL ? frame->pc : 0,
        .lr = frame != NULL ? frame->lr : 0,
        .cfsr = reg_read(&core->cfsr),
        .hfsr = reg_read(&core->hfsr),
        .mmfar = reg_read(&core->mmfar),
        .bfar = reg_read(&core->bfar),
    };
    crash->crc = crc_of(&crash->facts);
}

bool crash_is_there(const crash_t *crash)
{
    return crash->facts.magic == MAGIC && crash->crc == crc_of(&crash->facts);
}

void crash_clear(crash_t *crash)
{
    crash->facts.magic = 0;
}
