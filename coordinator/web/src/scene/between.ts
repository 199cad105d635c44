// Poses between two control steps: each link turns about its joint's axis, so that the chain stays whole.

import * as THREE from "three";

const inverse = new THREE.Matrix4();
const before = new THREE.Matrix4();
const after = new THREE.Matrix4();
const change = new THREE.Matrix4();
const axis = new THREE.Vector3();
const shift = new THREE.Vector3();
const turn = new THREE.Quaternion();
const p = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()] as const;
const q = [new THREE.Quaternion(), new THREE.Quaternion()] as const;

/** Index of the body that carries another one: the link before it, or of the first link of an arm the base. */
function parent(body: number, joints: readonly (readonly [number, number])[]): number {
    return joints.some(([first]) => first === body - 1) ? 0 : body - 1;
}

/** Poses at the share `t` of the way between the bodies of two moments; `joints` are those of each arm, `out` has a matrix for each body. */
export function bodiesBetween(
    from: Float32Array,
    to: Float32Array,
    t: number,
    joints: readonly (readonly [number, number])[],
    out: THREE.Matrix4[],
): void {
    for (const [body, matrix] of out.entries()) {
        matrix.fromArray(from, 16 * body);
        if (t <= 0) continue;
        if (body === 0) {
            rigid(matrix, before.fromArray(to, 0), t, matrix);
            continue;
        }
        const base = parent(body, joints);
        before.fromArray(from, 16 * body).premultiply(inverse.fromArray(from, 16 * base).invert());
        after.fromArray(to, 16 * body).premultiply(inverse.fromArray(to, 16 * base).invert());
        screw(before, after, t, matrix);
        matrix.premultiply(out[base] as THREE.Matrix4);
    }
}

/** A free body: straight on, and by the shortest turn. */
export function rigid(from: THREE.Matrix4, to: THREE.Matrix4, t: number, out: THREE.Matrix4): void {
    from.decompose(p[0], q[0], p[2]);
    to.decompose(p[1], q[1], p[2]);
    out.compose(p[0].lerp(p[1], t), q[0].slerp(q[1], t), p[2].set(1, 1, 1));
}

/** By a turn about the axis about which the whole change is one. */
function screw(from: THREE.Matrix4, to: THREE.Matrix4, t: number, out: THREE.Matrix4): void {
    change.copy(from).invert().premultiply(to);
    turn.setFromRotationMatrix(change);
    if (turn.w < 0) turn.set(-turn.x, -turn.y, -turn.z, -turn.w);
    const sine = Math.hypot(turn.x, turn.y, turn.z);
    // So small a turn is one straight on.
    if (sine < 1e-6) {
        rigid(from, to, t, out);
        return;
    }
    const angle = 2 * Math.atan2(sine, turn.w);
    axis.set(turn.x, turn.y, turn.z).divideScalar(sine);
    shift.setFromMatrixPosition(change);
    const along = axis.dot(shift);
    // A point of the axis: what the turn leaves where it is.
    const point = p[0].copy(axis).cross(shift).multiplyScalar(turn.w / sine);
    point.add(shift).addScaledVector(axis, -along).multiplyScalar(0.5);
    turn.setFromAxisAngle(axis, t * angle);
    const moved = p[1].copy(point).sub(p[2].copy(point).applyQuaternion(turn)).addScaledVector(axis, t * along);
    change.makeRotationFromQuaternion(turn).setPosition(moved);
    out.multiplyMatrices(change, from);
}
