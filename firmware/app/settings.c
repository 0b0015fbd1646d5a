// SPDX-License-Identifier: MIT
#include "settings.h"

#include "crc.h"
#include "messages.h"
#include "wire.h"

#include <assert.h>
#include <stddef.h>
#include <string.h>

// A record, in words of four bytes, little-endian.
enum { WORD_MAGIC, WORD_TABLE, WORD_SEQUENCE, WORD_COUNT, WORD_VALUES };
enum {
    SLOT_WORDS = SETTINGS_SLOT_BYTES / 4,
    VALUES_MAX = SLOT_WORDS - WORD_VALUES - 1,
    RECORD_BYTES = 4 * (WORD_VALUES + PARAMETER_COUNT + 1),
    ERASED = 0xFF
};
static_assert(RECORD_BYTES <= (int)SETTINGS_SLOT_BYTES, "a set must fit into a slot");

#define MAGIC 0x3153424Fu // "OBS1": what the words are, version 1

typedef struct {
    uint8_t byte[SETTINGS_SLOT_BYTES];
} slot_t;

/// What the pages hold.
typedef struct {
    bool readable;
    bool found; // a whole set, of whatever firmware; the newest is
    uint8_t page;
    uint32_t slot;
    uint32_t sequence;
    uint32_t used[SETTINGS_PAGES]; // slots up to the last that is not blank
} survey_t;

// ---- a slot

static uint32_t word_of(const slot_t *slot, size_t word)
{
    return wire_load(&slot->byte[4 * word]);
}

static void put_word(slot_t *slot, size_t word, uint32_t value)
{
    wire_store(&slot->byte[4 * word], value);
}

static bool is_blank(const slot_t *slot)
{
    uint8_t all = ERASED;
    for (uint32_t i = 0; i < SETTINGS_SLOT_BYTES; i++) {
        all &= slot->byte[i];
    }
    return all == ERASED;
}

static uint32_t checksum(const slot_t *slot, uint32_t words)
{
    uint32_t crc = CRC32_START;
    for (uint32_t i = 0; i < 4 * words; i++) {
        crc = crc32_update(crc, slot->byte[i]);
    }
    return crc32_finish(crc);
}

static bool is_whole(const slot_t *slot)
{
    const uint32_t count = word_of(slot, WORD_COUNT);
    if (word_of(slot, WORD_MAGIC) != MAGIC || count > VALUES_MAX) {
        return false;
    }
    return word_of(slot, WORD_VALUES + count) == checksum(slot, WORD_VALUES + count);
}

static void make_record(slot_t *slot, const parameters_t *parameters, uint32_t sequence)
{
    memset(slot, ERASED, sizeof *slot);
    put_word(slot, WORD_MAGIC, MAGIC);
    put_word(slot, WORD_TABLE, PARAMETER_TABLE_HASH);
    put_word(slot, WORD_SEQUENCE, sequence);
    put_word(slot, WORD_COUNT, PARAMETER_COUNT);
    for (uint32_t i = 0; i < PARAMETER_COUNT; i++) {
        put_word(slot, WORD_VALUES + i, wire_float_bits(parameters->value[i]));
    }
    put_word(slot, WORD_VALUES + PARAMETER_COUNT, checksum(slot, WORD_VALUES + PARAMETER_COUNT));
}

/// All values or none: false for a set of another table, or with a value that may not be set.
static bool take_values(const slot_t *slot, parameters_t *parameters)
{
    if (word_of(slot, WORD_TABLE) != PARAMETER_TABLE_HASH || word_of(slot, WORD_COUNT) != PARAMETER_COUNT) {
        return false;
    }
    parameters_t taken = *parameters;
    for (uint32_t i = 0; i < PARAMETER_COUNT; i++) {
        const float value = wire_float(word_of(slot, WORD_VALUES + i));
        if (parameters_set(&taken, (uint8_t)i, value) != PARAMETER_VALUE_RESULT_OK) {
            return false;
        }
    }
    *parameters = taken;
    return true;
}

// ---- the pages

static uint32_t slots_of(const settings_memory_t *memory)
{
    return memory->page_bytes / SETTINGS_SLOT_BYTES;
}

static bool read_slot(const settings_memory_t *memory, uint8_t page, uint32_t number, slot_t *slot)
{
    return memory->read(memory->context, page, number * SETTINGS_SLOT_BYTES, slot->byte, SETTINGS_SLOT_BYTES);
}

/// Sequence numbers run over: of two that lie near each other the newer one is ahead by less than half of them all.
static bool is_newer(uint32_t sequence, uint32_t than)
{
    return sequence - than - 1u < UINT32_MAX / 2u;
}

static void note_slot(survey_t *survey, uint8_t page, uint32_t number, const slot_t *slot)
{
    if (is_blank(slot)) {
        return;
    }
    survey->used[page] = number + 1;
    const uint32_t sequence = word_of(slot, WORD_SEQUENCE);
    if (is_whole(slot) && (!survey->found || is_newer(sequence, survey->sequence))) {
        survey->found = true;
        survey->page = page;
        survey->slot = number;
        survey->sequence = sequence;
    }
}

/// One slot at a time goes through the caller's memory: the stack has not room for many.
static survey_t survey_pages(const settings_memory_t *memory, slot_t *slot)
{
    survey_t survey = {.readable = true};
    for (uint32_t page = 0; page < SETTINGS_PAGES; page++) {
        for (uint32_t number = 0; number < slots_of(memory); number++) {
            if (!read_slot(memory, (uint8_t)page, number, slot)) {
                return (survey_t){.readable = false};
            }
            note_slot(&survey, (uint8_t)page, number, slot);
        }
    }
    return survey;
}

static bool has_word(const settings_memory_t *memory, uint8_t page, uint32_t offset, uint32_t word)
{
    uint8_t byte[4];
    return memory->read(memory->context, page, offset, byte, sizeof byte) && wire_load(byte) == word;
}

/// A page that is moved to is erased even if it reads as blank: after an erase cut short that may not last.
static bool make_blank(const settings_memory_t *memory, uint8_t page)
{
    bool blank = memory->erase(memory->context, page);
    for (uint32_t offset = 0; offset < memory->page_bytes && blank; offset += 4u) {
        blank = has_word(memory, page, offset, UINT32_MAX);
    }
    return blank;
}

/// The slot holds this record, and nothing behind it.
static bool holds(const settings_memory_t *memory, uint8_t page, uint32_t number, const slot_t *record)
{
    bool same = true;
    for (uint32_t word = 0; word < SLOT_WORDS && same; word++) {
        same = has_word(memory, page, number * SETTINGS_SLOT_BYTES + 4u * word, word_of(record, word));
    }
    return same;
}

static bool write_record(const settings_memory_t *memory, uint8_t page, uint32_t number, const slot_t *record)
{
    return memory->program(memory->context, page, number * SETTINGS_SLOT_BYTES, record->byte, RECORD_BYTES) &&
           holds(memory, page, number, record);
}

// ---- the outside

settings_result_t settings_load(const settings_memory_t *memory, parameters_t *parameters)
{
    parameters_reset(parameters);
    slot_t slot;
    const survey_t survey = survey_pages(memory, &slot);
    if (!survey.found) {
        const bool untouched = survey.readable && survey.used[0] == 0 && survey.used[1] == 0;
        return untouched ? SETTINGS_EMPTY : SETTINGS_LOST;
    }
    const bool taken =
        read_slot(memory, survey.page, survey.slot, &slot) && is_whole(&slot) && take_values(&slot, parameters);
    return taken ? SETTINGS_OK : SETTINGS_LOST;
}

bool settings_save(const settings_memory_t *memory, const parameters_t *parameters)
{
    slot_t record;
    const survey_t survey = survey_pages(memory, &record);
    if (!survey.readable) {
        return false;
    }
    make_record(&record, parameters, survey.sequence);
    if (survey.found && holds(memory, survey.page, survey.slot, &record)) {
        return true;
    }
    make_record(&record, parameters, survey.sequence + 1u);
    const uint32_t next = survey.used[survey.page];
    if (next < slots_of(memory)) {
        return write_record(memory, survey.page, next, &record);
    }
    const uint8_t other = survey.page ^ 1u;
    return make_blank(memory, other) && write_record(memory, other, 0, &record);
}
