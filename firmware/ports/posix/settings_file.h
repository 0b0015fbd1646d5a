// SPDX-License-Identifier: MIT
// The two pages of app/settings.h in a file, which stands for a board's flash: erased is 0xFF, and every write is on
// the disk before the call returns. What a crash cuts short is the log's own business.
#ifndef OMNIBOT_PORTS_POSIX_SETTINGS_FILE_H
#define OMNIBOT_PORTS_POSIX_SETTINGS_FILE_H

#include "settings.h"

enum { SETTINGS_FILE_PAGE_BYTES = 8192, SETTINGS_FILE_BYTES = SETTINGS_PAGES * SETTINGS_FILE_PAGE_BYTES };

typedef struct {
    int handle; // −1: none is open
    settings_memory_t memory;
} settings_file_t;

/// Opens the file, or makes one with both pages erased. False, after one line on stderr that names the file and says
/// what is wrong with it, when it can't be read and written, has another size, or another process holds it.
bool settings_file_open(settings_file_t *file, const char *name);

#endif
