// The robot's bodies as they collide.

import * as THREE from "three";
import type { Description, Shape } from "../simulation/types";
import { CONTACT, ofArm } from "./colours";

/** How long a body glows after it has touched something (s of the page's time). */
const GLOW = 0.35;

export class RobotView {
    readonly group = new THREE.Group();
    /** One a body; their poses are set, never computed. */
    readonly bodies: THREE.Group[];
    private readonly glow: number[];
    private readonly materials: THREE.MeshStandardMaterial[];

    constructor(description: Description) {
        this.materials = [];
        this.glow = description.bodies.map(() => 0);
        this.bodies = description.bodies.map((body, index) => {
            const group = new THREE.Group();
            group.matrixAutoUpdate = false;
            const [first, end] = description.joints[body.arm ?? 0] ?? [0, 0];
            const material = new THREE.MeshStandardMaterial({
                color: body.arm === null ? "#c9ced6" : armColour(body.arm, index - 1 - first, end - first),
                roughness: 0.62,
                metalness: 0.05,
                emissive: CONTACT,
                emissiveIntensity: 0,
            });
            this.materials.push(material);
            for (const shape of body.shapes) {
                const mesh = meshOf(shape, material);
                mesh.userData["body"] = index;
                group.add(mesh);
            }
            this.group.add(group);
            return group;
        });
    }

    pose(body: number, matrix: THREE.Matrix4): void {
        const group = this.bodies[body];
        if (group === undefined) return;
        group.matrix.copy(matrix);
        group.matrixWorldNeedsUpdate = true;
    }

    /** Lets a body glow. */
    touch(body: number): void {
        this.glow[body] = GLOW;
    }

    tick(seconds: number): void {
        this.materials.forEach((material, index) => {
            const left = Math.max(0, (this.glow[index] ?? 0) - seconds);
            this.glow[index] = left;
            material.emissiveIntensity = (0.9 * left) / GLOW;
        });
    }

    dispose(): void {
        this.group.traverse((object) => {
            if (object instanceof THREE.Mesh) (object.geometry as THREE.BufferGeometry).dispose();
        });
        for (const material of this.materials) material.dispose();
    }
}

/** Light links, with the arm's colour towards the hand; `links` are those of the arm. */
function armColour(arm: number, link: number, links: number): THREE.Color {
    const shares = [0.35, 0.2, 0.2, 0.55, 0.75, 1];
    const share = shares[Math.round((link * (shares.length - 1)) / Math.max(links - 1, 1))] ?? 0.3;
    return new THREE.Color("#e4e7ec").lerp(new THREE.Color(ofArm(arm)), share);
}

function meshOf(shape: Shape, material: THREE.Material): THREE.Mesh {
    if ("capsule" in shape) {
        const { from, to, radius } = shape.capsule;
        const [a, b] = [new THREE.Vector3(...from), new THREE.Vector3(...to)];
        const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(radius, a.distanceTo(b), 6, 20), material);
        along(mesh, b.clone().sub(a));
        mesh.position.copy(a.add(b).multiplyScalar(0.5));
        return mesh;
    }
    if ("disc" in shape) {
        const { centre, axis, radius, half_height } = shape.disc;
        const mesh = new THREE.Mesh(new THREE.CylinderGeometry(radius, radius, 2 * half_height, 32), material);
        along(mesh, new THREE.Vector3(...axis));
        mesh.position.set(...centre);
        return mesh;
    }
    const { half, centre, rotation: r } = shape.box;
    const [x, y, z] = half;
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(2 * x, 2 * y, 2 * z), material);
    const n = (index: number): number => r[index] ?? 0;
    const turned = new THREE.Matrix4().set(n(0), n(1), n(2), 0, n(3), n(4), n(5), 0, n(6), n(7), n(8), 0, 0, 0, 0, 1);
    mesh.quaternion.setFromRotationMatrix(turned);
    mesh.position.set(...centre);
    return mesh;
}

/** Turns a shape that stands along y. */
function along(mesh: THREE.Mesh, axis: THREE.Vector3): void {
    if (axis.lengthSq() > 0) mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), axis.normalize());
}
