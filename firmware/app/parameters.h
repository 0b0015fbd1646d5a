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

enum { PARAMETER_TEXT_CHARACTERS = 6 }; // that a frame carries

void parameters_reset(parameters_t *parameters);

/// Sets one parameter; returns a PARAMETER_VALUE_RESULT_… of the wire, and changes nothing unless it is OK.
uint8_t parameters_set(parameters_t *parameters, uint8_t index, float value);

/// A field that is a number: FIELD_VALUE … FIELD_TYPE of the wire. The type is 0 for a real number, 1 for a whole one.
float parameters_field(const parameters_t *parameters, uint8_t index, uint8_t field);

/// A part of a field that is a text, FIELD_NAME or FIELD_UNIT: zeros behind its end.
void parameters_text(uint8_t index, uint8_t field, uint8_t part, char text[PARAMETER_TEXT_CHARACTERS]);

/// What the controller makes of them.
control_params_t parameters_for_control(const parameters_t *parameters, const robot_t *robot);

#endif
