// SPDX-License-Identifier: MIT
#include "parameters.h"

#include "messages.h"

void parameters_reset(parameters_t *parameters)
{
    for (int i = 0; i < PARAMETER_COUNT; i++) {
        parameters->value[i] = parameter_table[i].initial;
    }
}

/// The value lies in its range, and is whole where it must be. NaN does neither.
static bool is_allowed(const parameter_description_t *description, float value)
{
    if (!(value >= description->minimum && value <= description->maximum)) {
        return false;
    }
    if (!description->integer) {
        return true;
    }
    const float fraction = value - (float)(int32_t)value;
    return !(fabsf(fraction) > 0.0f);
}

uint8_t parameters_set(parameters_t *parameters, uint8_t index, float value)
{
    if (index >= PARAMETER_COUNT) {
        return PARAMETER_VALUE_RESULT_UNKNOWN_INDEX;
    }
    if (!is_allowed(&parameter_table[index], value)) {
        return PARAMETER_VALUE_RESULT_OUT_OF_RANGE;
    }
    parameters->value[index] = value;
    return PARAMETER_VALUE_RESULT_OK;
}

float parameters_field(const parameters_t *parameters, uint8_t index, uint8_t field)
{
    const parameter_description_t *description = &parameter_table[index];
    switch (field) {
    case FIELD_DEFAULT:
        return description->initial;
    case FIELD_MINIMUM:
        return description->minimum;
    case FIELD_MAXIMUM:
        return description->maximum;
    case FIELD_TYPE:
        return description->integer ? 1.0f : 0.0f;
    default:
        return parameters->value[index];
    }
}

void parameters_text(uint8_t index, uint8_t field, uint8_t part, char text[PARAMETER_TEXT_CHARACTERS])
{
    const char *next = field == FIELD_NAME ? parameter_table[index].name : parameter_table[index].unit;
    for (int left = part * PARAMETER_TEXT_CHARACTERS; left > 0 && *next != '\0'; left--) {
        next++;
    }
    for (int i = 0; i < PARAMETER_TEXT_CHARACTERS; i++) {
        text[i] = *next;
        next += *next != '\0' ? 1 : 0;
    }
}

control_params_t parameters_for_control(const parameters_t *parameters, const robot_t *robot)
{
    const float *value = parameters->value;
    const float K1 = value[PARAMETER_POSITION_STIFFNESS_PER_S2];
    const float K2 = value[PARAMETER_POSITION_DAMPING_PER_S];
    control_params_t params = {
        .robot = robot,
        .order = (int32_t)value[PARAMETER_ORDER],
        .floor = {.curve = &robot->floor_curve,
                  .linear = (int32_t)value[PARAMETER_TRACTION] == 0,
                  .compliance_per_N = value[PARAMETER_EPSILON] * robot->normalised_compliance_per_N,
                  .friction_limit_N = value[PARAMETER_FRICTION_LIMIT_N]},
        .delta_mps = value[PARAMETER_DELTA_M_PER_S],
        .speed_length_m = value[PARAMETER_SPEED_LENGTH_M],
        .law = {.output = (int32_t)value[PARAMETER_OUTPUT] == 0 ? OUTPUT_POSTURE : OUTPUT_POINT,
                .stiffness_per_s2 = {K1, K1, value[PARAMETER_HEADING_STIFFNESS_PER_S2]},
                .damping_per_s = {K2, K2, value[PARAMETER_HEADING_DAMPING_PER_S]}},
        .series_ratio_max = value[PARAMETER_SERIES_RATIO_MAX],
        .observer_lag_s = value[PARAMETER_OBSERVER_LAG_S],
        .force_bound_N = value[PARAMETER_FORCE_BOUND_N],
        .torque_bound_Nm = value[PARAMETER_TORQUE_BOUND_NM],
    };
    control_prepare(&params);
    return params;
}
