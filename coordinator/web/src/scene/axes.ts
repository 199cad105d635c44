// Three axes as solid rods: x red, y green, z blue, with a ball in the colour of what they belong to.

import * as THREE from "three";

const COLOURS = ["#e5484d", "#30a46c", "#3e63dd"] as const;

export function axes(length: number, thickness: number, ball: string): THREE.Group {
    const group = new THREE.Group();
    COLOURS.forEach((colour, index) => {
        const rod = new THREE.Mesh(
            new THREE.CylinderGeometry(thickness, thickness, length, 12),
            new THREE.MeshStandardMaterial({ color: colour, roughness: 0.5 }),
        );
        rod.position.setComponent(index, length / 2);
        if (index === 0) rod.rotation.z = -Math.PI / 2;
        if (index === 2) rod.rotation.x = Math.PI / 2;
        group.add(rod);
    });
    group.add(
        new THREE.Mesh(
            new THREE.SphereGeometry(3.2 * thickness, 20, 14),
            new THREE.MeshStandardMaterial({ color: ball, roughness: 0.4 }),
        ),
    );
    return group;
}
