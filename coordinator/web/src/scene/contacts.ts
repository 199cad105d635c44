// Contacts as flashes: a bright point where two bodies push each other, which fades.

import * as THREE from "three";
import type { Frame } from "../simulation/types";
import { CONTACT } from "./colours";

const TIME = 0.5;
const MOST = 24;

export class Flashes {
    readonly group = new THREE.Group();
    private readonly left: number[] = [];
    private next = 0;

    constructor() {
        const geometry = new THREE.SphereGeometry(0.05, 16, 10);
        for (let i = 0; i < MOST; i++) {
            const material = new THREE.MeshBasicMaterial({ color: CONTACT, transparent: true, depthTest: false });
            const ball = new THREE.Mesh(geometry, material);
            ball.visible = false;
            this.left.push(0);
            this.group.add(ball);
        }
    }

    /** Shows what pushes at this moment; returns the bodies. */
    show({ contacts }: Frame): number[] {
        const bodies: number[] = [];
        for (let at = 0; at + 8 <= contacts.length; at += 8) {
            const [x = 0, y = 0, z = 0, , , , a = 0, b = 0] = contacts.subarray(at, at + 8);
            const ball = this.group.children[this.next];
            ball?.position.set(x, y, z);
            this.left[this.next] = TIME;
            this.next = (this.next + 1) % MOST;
            bodies.push(a, b);
        }
        return bodies;
    }

    tick(seconds: number): void {
        this.group.children.forEach((ball, index) => {
            const left = Math.max(0, (this.left[index] ?? 0) - seconds);
            this.left[index] = left;
            ball.visible = left > 0;
            ball.scale.setScalar(1 + 1.2 * (1 - left / TIME));
            ((ball as THREE.Mesh).material as THREE.MeshBasicMaterial).opacity = left / TIME;
        });
    }
}
