// SPDX-License-Identifier: MIT
// What voltage gives a torque: the steady state of a brushed motor behind a gear. Pure. The numbers come from
// firmware/robot/omnibot.toml.
//
//   U = R τ/(kt N) + kt N φ̇
//
// with the torque τ and the speed φ̇ of the wheel, winding resistance R, torque constant kt of the motor's shaft (N·m/A;
// V·s/rad is the same number), gear ratio N. The winding's inductance is left out: its time constant, some 0.2 ms, is
// far below the control period. So are the gear's friction and efficiency: the wheel gets less than it is asked for.
#ifndef OMNIBOT_STM32F405_MOTOR_H
#define OMNIBOT_STM32F405_MOTOR_H

typedef struct {
    float resistance_Ohm;       // R
    float torque_constant_Nm_A; // kt
    float gear_ratio;           // N
    float supply_nominal_V;
    float encoder_counts; // a turn of the wheel
} motor_t;

/// The motors of firmware/robot/omnibot.toml.
extern const motor_t omnibot_motor;

/// Share of the supply to put on the motor, negative backwards, for a torque at the wheel while that turns so fast;
/// held within ±duty_max. 0 where the supply is not positive or anything is not a number.
float motor_duty(const motor_t *motor, float torque_Nm, float wheel_rad_per_s, float supply_V, float duty_max);

#endif
