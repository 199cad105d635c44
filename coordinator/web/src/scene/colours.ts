// The colours of the arms, the same in the scene and in the curves: Okabe and Ito's, which all eyes tell apart.

export const ARMS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"] as const;

/** Of an arm. */
export function ofArm(arm: number): string {
    return ARMS[arm % ARMS.length] as string;
}

/** Of what touches. */
export const CONTACT = "#e5484d";
/** Of forces. */
export const FORCE = "#f5a524";
