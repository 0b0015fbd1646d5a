// SPDX-License-Identifier: MIT
#define _DEFAULT_SOURCE
#include "settings_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

static int handle_of(void *context)
{
    return *(const int *)context;
}

static off_t place_of(uint8_t page, uint32_t offset)
{
    return (off_t)page * SETTINGS_FILE_PAGE_BYTES + (off_t)offset;
}

// ---- the memory

static bool read_file(void *context, uint8_t page, uint32_t offset, uint8_t *bytes, uint32_t length)
{
    return pread(handle_of(context), bytes, length, place_of(page, offset)) == (ssize_t)length;
}

static bool program_file(void *context, uint8_t page, uint32_t offset, const uint8_t *bytes, uint32_t length)
{
    const int handle = handle_of(context);
    return pwrite(handle, bytes, length, place_of(page, offset)) == (ssize_t)length && fsync(handle) == 0;
}

static bool erase_file(void *context, uint8_t page)
{
    uint8_t erased[SETTINGS_FILE_PAGE_BYTES];
    memset(erased, 0xFF, sizeof erased);
    return program_file(context, page, 0, erased, sizeof erased);
}

// ---- opening it

static bool refuse(settings_file_t *file, const char *name, const char *why)
{
    fprintf(stderr, "omnibot-sil: --parameters %s: %s\n", name, why);
    if (file->handle >= 0) {
        close(file->handle);
        file->handle = -1;
    }
    return false;
}

/// A new file has no bytes yet. The second page first: so it has its size at once.
static bool is_of_size(settings_file_t *file)
{
    struct stat status;
    if (fstat(file->handle, &status) != 0 || !S_ISREG(status.st_mode)) {
        return false;
    }
    if (status.st_size == 0) {
        return erase_file(&file->handle, 1) && erase_file(&file->handle, 0);
    }
    return status.st_size == SETTINGS_FILE_BYTES;
}

bool settings_file_open(settings_file_t *file, const char *name)
{
    file->handle = open(name, O_RDWR | O_CREAT | O_CLOEXEC, 0644);
    if (file->handle < 0) {
        return refuse(file, name, strerror(errno));
    }
    if (flock(file->handle, LOCK_EX | LOCK_NB) != 0) {
        return refuse(file, name, "another omnibot-sil keeps its parameters there; give each a file of its own");
    }
    if (!is_of_size(file)) {
        char why[96];
        snprintf(why, sizeof why, "is no file of parameters, which has %d bytes; name another, or remove it",
                 SETTINGS_FILE_BYTES);
        return refuse(file, name, why);
    }
    file->memory = (settings_memory_t){
        .context = &file->handle,
        .page_bytes = SETTINGS_FILE_PAGE_BYTES,
        .read = read_file,
        .erase = erase_file,
        .program = program_file,
    };
    return true;
}
