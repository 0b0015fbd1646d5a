// SPDX-License-Identifier: MIT
// Bytes between an interrupt and the main loop: one side puts, the other takes, neither waits. The counts run freely
// and wrap; each is written by one side only.
#ifndef OMNIBOT_STM32F405_RING_H
#define OMNIBOT_STM32F405_RING_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

enum { RING_BYTES = 1024 }; // a power of two

typedef struct {
    _Atomic uint32_t put, taken;
    uint8_t byte[RING_BYTES];
} ring_t;

static inline uint32_t ring_room(ring_t *ring)
{
    return RING_BYTES - (atomic_load_explicit(&ring->put, memory_order_relaxed) -
                         atomic_load_explicit(&ring->taken, memory_order_acquire));
}

/// Returns false, and keeps what is there, when the ring is full.
static inline bool ring_put(ring_t *ring, uint8_t byte)
{
    if (ring_room(ring) == 0) {
        return false;
    }
    const uint32_t put = atomic_load_explicit(&ring->put, memory_order_relaxed);
    ring->byte[put % RING_BYTES] = byte;
    atomic_store_explicit(&ring->put, put + 1u, memory_order_release);
    return true;
}

/// Returns false when there is none.
static inline bool ring_take(ring_t *ring, uint8_t *byte)
{
    const uint32_t taken = atomic_load_explicit(&ring->taken, memory_order_relaxed);
    if (taken == atomic_load_explicit(&ring->put, memory_order_acquire)) {
        return false;
    }
    *byte = ring->byte[taken % RING_BYTES];
    atomic_store_explicit(&ring->taken, taken + 1u, memory_order_release);
    return true;
}

#endif
