// SPDX-License-Identifier: MIT
// Preloaded into a User-Mode-Linux kernel on processors with a register file larger than that kernel knows (Intel AMX).
//
// UML saves and restores its processes' floating-point registers in a fixed buffer. Reading fewer bytes than the
// processor has is allowed; writing fewer is refused by the host with EFAULT, and UML gives up at its first process. So
// each such write is padded with zeros to the host's size, and marked as not carrying the registers it has no room for.

#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

typedef long ptrace_fn(int request, pid_t pid, void *addr, void *data);

enum { XSTATE_MAX = 1 << 16, HEADER = 512 };         // XSAVE's layout: the bit mask of valid components is at byte 512
static const uint64_t AMX_TILES = UINT64_C(3) << 17; // components 17 and 18, the ones beyond UML's buffer

static long write_padded(ptrace_fn *real, pid_t pid, void *addr, const struct iovec *regs)
{
    static unsigned char image[XSTATE_MAX];
    static size_t host_size;
    if (host_size == 0) {
        struct iovec all = {.iov_base = image, .iov_len = sizeof image};
        if (real(PTRACE_GETREGSET, pid, addr, &all) != 0) {
            return -1;
        }
        host_size = all.iov_len;
        memset(image, 0, sizeof image);
    }
    if (regs->iov_len >= host_size || regs->iov_len < HEADER + sizeof(uint64_t)) {
        return real(PTRACE_SETREGSET, pid, addr, (void *)regs);
    }
    memcpy(image, regs->iov_base, regs->iov_len);
    uint64_t valid;
    memcpy(&valid, image + HEADER, sizeof valid);
    valid &= ~AMX_TILES;
    memcpy(image + HEADER, &valid, sizeof valid);
    struct iovec all = {.iov_base = image, .iov_len = host_size};
    return real(PTRACE_SETREGSET, pid, addr, &all);
}

long ptrace(enum __ptrace_request request, ...)
{
    static ptrace_fn *real;
    if (real == NULL) {
        *(void **)&real = dlsym(RTLD_NEXT, "ptrace");
    }
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *addr = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    if (request == PTRACE_SETREGSET && (uintptr_t)addr == NT_X86_XSTATE) {
        return write_padded(real, pid, addr, data);
    }
    return real((int)request, pid, addr, data);
}
