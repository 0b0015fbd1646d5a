// SPDX-License-Identifier: MIT
#include "control.h"

#include "kinematics.h"
#include "manifold.h"

/// What the law asks for at one order of the expansion.
typedef struct {
    vec3_t twist;              // ν
    vec3_t eta;                // η
    vec3_t wheel_force_N;      // λ = λ0 + ε λ1
    vec3_t wheel_acceleration; // φ̈ = J v̇ − r ε Ḣ0
} demand_t;

static bool input_is_finite(const control_input_t *input)
{
    return vec3_is_finite(input->pose) && vec3_is_finite(input->wheel_speed_rad_per_s) &&
           vec3_is_finite(input->reference.position) && vec3_is_finite(input->reference.velocity) &&
           vec3_is_finite(input->reference.acceleration) && vec3_is_finite(input->reference.jerk);
}

/// The factor that brings the largest entry down to a bound; 1 where it is within.
static float scale_to_bound(vec3_t value, float bound)
{
    const float largest = vec3_max_abs(value);
    return largest > bound ? bound / largest : 1.0f;
}

/// κ at a twist ν that changes at the rate η.
static mobility_t mobility_at(const control_params_t *params, vec3_t twist, vec3_t eta)
{
    const float per_stiffness = 1.0f / params->robot->normalised_stiffness_N;
    return (mobility_t){
        .value = (kinematics_speed(twist, params->speed_length_m) + params->delta_mps) * per_stiffness,
        .rate = kinematics_speed_rate(twist, eta, params->speed_length_m) * per_stiffness,
    };
}

/// N = 0: the wheels roll without slip, ν = v = v_odo.
static demand_t demand_order0(const control_params_t *params, const tracking_t *tracking, vec3_t odometry)
{
    const vec3_t eta = tracking_eta(params->robot, &params->gains, tracking, odometry);
    return (demand_t){
        .twist = odometry,
        .eta = eta,
        .wheel_force_N = manifold_force0(params->robot, odometry, eta),
        .wheel_acceleration = mat3_apply(&params->robot->wheel_rate_of_twist, eta),
    };
}

/// N = 1: the slip that order 0 predicts corrects the velocity, and the manifold's motion the torque.
static demand_t demand_order1(const control_params_t *params, const tracking_t *tracking, vec3_t odometry)
{
    const robot_t *robot = params->robot;
    const float epsilon = params->epsilon_per_N;
    const demand_t base = demand_order0(params, tracking, odometry);
    const mobility_t base_mobility = mobility_at(params, odometry, base.eta);
    // The floor feels the bounded force: that is what slips.
    const vec3_t slipping_force =
        vec3_scale(scale_to_bound(base.wheel_force_N, params->force_bound_N), base.wheel_force_N);

    // ν = v_odo + Jr⁻¹ Γ ε H0 (C5), v = ν − ε Jrᵀ H0 (2)
    const vec3_t slip_twist = mat3_apply(&robot->twist_of_contact_speed, slipping_force);
    const vec3_t twist = vec3_add_scaled(odometry, -epsilon * base_mobility.value, slip_twist);
    const vec3_t base_H0 = manifold_of_force(robot, base_mobility.value, slipping_force);
    const vec3_t v = vec3_add_scaled(twist, -epsilon, mat3_apply(&robot->body_force_of_wheels, base_H0));

    const vec3_t eta = tracking_eta(robot, &params->gains, tracking, twist);
    const vec3_t eta_rate = tracking_eta_rate(robot, &params->gains, tracking, twist, eta);
    const mobility_t mobility = mobility_at(params, twist, eta);
    const vec3_t H0 = manifold_of_force(robot, mobility.value, manifold_force0(robot, v, eta));
    const vec3_t H0_rate = manifold_rate0(robot, mobility, v, eta, eta_rate);
    // η is the ν̇ wanted, the recursion takes v̇ = ν̇ − ε Jrᵀ Ḣ0 (C6)
    const vec3_t v_rate = vec3_add_scaled(eta, -epsilon, mat3_apply(&robot->body_force_of_wheels, H0_rate));
    const vec3_t force0 = manifold_force0(robot, v, v_rate);
    return (demand_t){
        .twist = twist,
        .eta = eta,
        .wheel_force_N = vec3_add_scaled(force0, epsilon, manifold_force1(robot, v, H0, H0_rate)),
        .wheel_acceleration =
            vec3_add_scaled(mat3_apply(&robot->wheel_rate_of_twist, v_rate), -epsilon * robot->wheel_radius_m, H0_rate),
    };
}

/// τ = r λ + Iw φ̈ (32), (29), with λ and then τ held within their bounds.
static void bounded_torque(const control_params_t *params, const demand_t *demand, control_output_t *output)
{
    const robot_t *robot = params->robot;
    const float force_scale = scale_to_bound(demand->wheel_force_N, params->force_bound_N);
    output->wheel_force_N = vec3_scale(force_scale, demand->wheel_force_N);
    const vec3_t rolling = vec3_scale(robot->wheel_radius_m, output->wheel_force_N);
    const vec3_t torque = vec3_add_scaled(rolling, force_scale * robot->wheel_inertia_kgm2, demand->wheel_acceleration);
    const float torque_scale = scale_to_bound(torque, params->torque_bound_Nm);
    output->torque_Nm = vec3_scale(torque_scale, torque);
    output->force_bounded = force_scale < 1.0f;
    output->torque_bounded = torque_scale < 1.0f;
}

bool control_step(const control_params_t *params, const control_input_t *input, control_output_t *output)
{
    *output = (control_output_t){0};
    if (!input_is_finite(input)) {
        return false;
    }
    const tracking_t tracking = tracking_from(params->robot, input->pose, &input->reference);
    const vec3_t odometry = kinematics_odometry(params->robot, input->wheel_speed_rad_per_s);
    const demand_t demand =
        params->order == 0 ? demand_order0(params, &tracking, odometry) : demand_order1(params, &tracking, odometry);
    bounded_torque(params, &demand, output);
    const mobility_t mobility = mobility_at(params, demand.twist, demand.eta);
    output->mu_mps = manifold_of_force(params->robot, mobility.value, output->wheel_force_N);
    output->twist = demand.twist;
    output->eta = demand.eta;
    output->error = tracking.error;
    if (!vec3_is_finite(output->torque_Nm) || !vec3_is_finite(output->mu_mps)) {
        *output = (control_output_t){0};
        return false;
    }
    return true;
}
