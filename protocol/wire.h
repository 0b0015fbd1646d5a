// SPDX-License-Identifier: MIT
// What the generated codec is made of: words of the payload, and physical values rounded to whole raw steps.
#ifndef OMNIBOT_PROTOCOL_WIRE_H
#define OMNIBOT_PROTOCOL_WIRE_H

#include <math.h>
#include <stdint.h>
#include <string.h>

static inline uint32_t wire_load(const uint8_t *byte)
{
    return (uint32_t)byte[0] | (uint32_t)byte[1] << 8 | (uint32_t)byte[2] << 16 | (uint32_t)byte[3] << 24;
}

static inline void wire_store(uint8_t *byte, uint32_t word)
{
    byte[0] = (uint8_t)word;
    byte[1] = (uint8_t)(word >> 8);
    byte[2] = (uint8_t)(word >> 16);
    byte[3] = (uint8_t)(word >> 24);
}

/// Raw value nearest to `value` in steps of the resolution, held within ±`raw_max`; NaN becomes the value below
/// −`raw_max`, which the wire keeps for 'not available'.
static inline int32_t wire_quantise(float value, float steps_per_unit, int32_t raw_max)
{
    const float steps = value * steps_per_unit;
    if (isnan(steps)) {
        return -raw_max - 1;
    }
    if (steps >= (float)raw_max) {
        return raw_max;
    }
    if (steps <= -(float)raw_max) {
        return -raw_max;
    }
    return (int32_t)(steps + (steps < 0.0f ? -0.5f : 0.5f));
}

/// Physical value of a raw one; NaN where the sender had none.
static inline float wire_physical(int32_t raw, float unit_per_step, int32_t raw_max)
{
    return raw < -raw_max ? NAN : (float)raw * unit_per_step;
}

/// Signed value of the low bits of `raw`, given the field's sign bit.
static inline int32_t wire_sign_extend(uint32_t raw, uint32_t sign_bit)
{
    return (int32_t)(raw ^ sign_bit) - (int32_t)sign_bit;
}

static inline float wire_float(uint32_t bits)
{
    float value;
    (void)memcpy(&value, &bits, sizeof value);
    return value;
}

static inline uint32_t wire_float_bits(float value)
{
    uint32_t bits;
    (void)memcpy(&bits, &value, sizeof bits);
    return bits;
}

#endif
