// A pointer that takes hold of a body and pulls: the arrow is the force.

import * as THREE from "three";
import type { Event } from "../simulation/types";
import { FORCE } from "./colours";
import type { Stage } from "./stage";

/** Newtons for each metre of the arrow, and at most. */
const STIFFNESS = 150;
const MOST = 600;

export class Push {
    readonly group = new THREE.Group();
    onForce: (newtons: number | undefined) => void = () => undefined;
    private body: number | undefined;
    private readonly point = new THREE.Vector3();
    private readonly target = new THREE.Vector3();
    private readonly force = new THREE.Vector3();
    private readonly plane = new THREE.Plane();
    private readonly arrow = new THREE.ArrowHelper(new THREE.Vector3(1, 0, 0), new THREE.Vector3(), 1, FORCE);

    constructor(
        private readonly stage: Stage,
        private readonly bodies: () => THREE.Group[],
    ) {
        for (const part of [this.arrow.line, this.arrow.cone]) {
            (part.material as THREE.Material).depthTest = false;
            part.renderOrder = 2;
        }
        this.group.add(this.arrow);
        this.group.visible = false;
    }

    get active(): boolean {
        return this.body !== undefined;
    }

    /** Takes hold of the body under the pointer. */
    begin(ray: THREE.Raycaster): boolean {
        const hit = ray.intersectObjects(this.bodies(), true)[0];
        const body = hit?.object.userData["body"] as number | undefined;
        if (hit === undefined || body === undefined) return false;
        this.body = body;
        this.point.copy(hit.point).applyMatrix4(this.inverse(body));
        this.target.copy(hit.point);
        const towards = this.stage.camera.getWorldDirection(new THREE.Vector3());
        this.plane.setFromNormalAndCoplanarPoint(towards, hit.point);
        this.stage.orbit.enabled = false;
        this.update();
        return true;
    }

    move(ray: THREE.Raycaster): void {
        if (this.body === undefined) return;
        ray.ray.intersectPlane(this.plane, this.target);
        this.update();
    }

    end(): void {
        if (this.body === undefined) return;
        this.body = undefined;
        this.group.visible = false;
        this.stage.orbit.enabled = true;
        this.onForce(undefined);
    }

    /** The arrow from where the body is now. */
    update(): void {
        if (this.body === undefined) return;
        const from = this.point.clone().applyMatrix4(this.bodies()[this.body]?.matrix ?? new THREE.Matrix4());
        this.force.copy(this.target).sub(from).multiplyScalar(STIFFNESS).clampLength(0, MOST);
        const length = this.force.length() / STIFFNESS;
        this.group.visible = length > 0.02;
        this.arrow.position.copy(from);
        if (length > 0.02) {
            this.arrow.setDirection(this.force.clone().normalize());
            this.arrow.setLength(length, Math.min(0.16, 0.4 * length), Math.min(0.08, 0.2 * length));
        }
        this.onForce(this.force.length());
    }

    /** What the simulator is told before its next step. */
    event(): Event | undefined {
        if (this.body === undefined || this.force.length() < 1) return undefined;
        const { point, force, body } = this;
        const wrench = {
            body,
            point: [point.x, point.y, point.z] as [number, number, number],
            force: [force.x, force.y, force.z] as [number, number, number],
            torque: [0, 0, 0] as [number, number, number],
        };
        return { effect: { effect: { wrench }, steps: 1 } };
    }

    private inverse(body: number): THREE.Matrix4 {
        return new THREE.Matrix4().copy(this.bodies()[body]?.matrix ?? new THREE.Matrix4()).invert();
    }
}
