//! How the robot moves between control steps: on smooth curves through where it stood after them.

use simulator::experiment::Pose;

/// Where the robot stands after a number of control steps, which need not be whole.
///
/// Positions and angles run on cubic curves that have the slope of their neighbours at each pose (Catmull and Rom); quaternions likewise, made unit length
/// again, which is exact enough for the small turns of a control step.
pub(super) fn pose_at(poses: &[Pose], steps: f64) -> Pose {
    let last = poses.len() - 1;
    let from = (steps.max(0.0) as usize).min(last.saturating_sub(1));
    let share = (steps - from as f64).clamp(0.0, 1.0) as f32;
    let four = [from.saturating_sub(1), from, (from + 1).min(last), (from + 2).min(last)];
    let [before, a, b, after] = four.map(|index| &poses[index]);
    let between =
        |read: &dyn Fn(&Pose) -> f32| curve([read(before), read(a), read(b), read(after)], share);
    // Of the two quaternions of an attitude the one on the side of the first.
    let side = |pose: &Pose| {
        let dot: f32 = (0..4).map(|i| pose.base_quaternion[i] * a.base_quaternion[i]).sum();
        if dot < 0.0 { -1.0 } else { 1.0 }
    };
    let quaternion: [f32; 4] =
        std::array::from_fn(|i| between(&|pose| side(pose) * pose.base_quaternion[i]));
    let length = quaternion.iter().map(|x| x * x).sum::<f32>().sqrt();
    Pose {
        base_position: std::array::from_fn(|i| between(&|pose| pose.base_position[i])),
        base_quaternion: quaternion.map(|x| x / length),
        joints: (0..a.joints.len()).map(|i| between(&|pose| pose.joints[i])).collect(),
    }
}

/// Between the middle two of four values.
fn curve([p0, p1, p2, p3]: [f32; 4], t: f32) -> f32 {
    let linear = 0.5 * (p2 - p0);
    let square = p0 - 2.5 * p1 + 2.0 * p2 - 0.5 * p3;
    let cube = 0.5 * (p3 - p0) + 1.5 * (p1 - p2);
    p1 + t * (linear + t * (square + t * cube))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f32) -> Pose {
        let (sin, cos) = (0.1 * x).sin_cos();
        // Written with the other sign every time: that is the same attitude.
        let sign = if (x as usize).is_multiple_of(2) { 1.0 } else { -1.0 };
        Pose {
            base_position: [x, x * x, 4.0],
            base_quaternion: [sign * cos, 0.0, sign * sin, 0.0],
            joints: vec![2.0 * x; 6],
        }
    }

    #[test]
    fn at_control_steps_it_stands_where_it_stood() {
        let poses: Vec<Pose> = [0.0, 1.0, 2.0, 3.0].map(pose).into();
        for (step, wanted) in poses.iter().enumerate() {
            let found = pose_at(&poses, step as f64);
            assert_eq!(found.base_position, wanted.base_position);
            assert_eq!(found.joints, wanted.joints);
        }
        assert_eq!(pose_at(&poses, 9.0).joints, poses[3].joints, "beyond the end");
        assert_eq!(pose_at(&poses[..1], 0.5).joints, poses[0].joints, "one alone");
    }

    #[test]
    fn between_them_it_moves_evenly_and_turns_the_short_way() {
        let poses: Vec<Pose> = [0.0, 1.0, 2.0, 3.0].map(pose).into();
        let found = pose_at(&poses, 1.5);
        assert!((found.base_position[0] - 1.5).abs() < 1e-6, "even motion stays even");
        assert!((found.base_position[1] - 2.25).abs() < 1e-6, "so does an even acceleration");
        let [w, _, y, _] = found.base_quaternion;
        assert!((y.atan2(w).abs() - 0.15).abs() < 1e-4 || (y / w - 0.15f32.tan()).abs() < 1e-4);
    }
}
