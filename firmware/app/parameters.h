// SPDX-License-Identifier: MIT
// The parameters that the host may set, by index; ranges and defaults come from firmware/robot/omnibot.toml.
#ifndef OMNIBOT_APP_PARAMETERS_H
#define OMNIBOT_APP_PARAMETERS_H

#include "control.h"
#include "parameter_table.h"

#include <stdint.h>

typedef struct {
    float value[PARAMETER_COUNT];
} parameters_t;

void parameters_reset(parameters_t *parameters);

/// Sets one parameter; returns a PARAMETER_VALUE_RESULT_… of the wire, and changes nothing unless it is OK.
uint8_t parameters_set(parameters_t *parameters, uint8_t index, float value);

/// What the controller makes of them.
control_params_t parameters_for_control(const parameters_t *parameters, const robot_t *robot);

#endif
