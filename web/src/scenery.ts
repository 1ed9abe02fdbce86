import * as THREE from "three";

const rulerCm = [-50, 150] as const;
const tileCm = 10;

/** Colours of the scene, for a light or a dark page. */
export interface Theme {
  sky: string;
  squares: [string, string];
  ruler: string;
  ink: string;
}

export const themes: Record<"light" | "dark", Theme> = {
  light: { sky: "#dfe8ee", squares: ["#b9c0be", "#c8cecc"], ruler: "#faf4d6", ink: "#282828" },
  dark: { sky: "#151b1f", squares: ["#272d2c", "#303736"], ruler: "#3b3a2f", ink: "#e4e0cc" },
};

function paint(width: number, height: number, draw: (context: CanvasRenderingContext2D) => void): THREE.CanvasTexture {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  draw(canvas.getContext("2d")!);
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 8;
  return texture;
}

/** Ground with squares of 2 cm. */
export function makeGround({ squares }: Theme): THREE.Mesh {
  const size = 8;
  const texture = paint(64, 64, (context) => {
    context.fillStyle = squares[0];
    context.fillRect(0, 0, 64, 64);
    context.fillStyle = squares[1];
    context.fillRect(0, 0, 32, 32);
    context.fillRect(32, 32, 32, 32);
  });
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.repeat.setScalar(size / 0.04);
  const ground = new THREE.Mesh(new THREE.PlaneGeometry(size, size), new THREE.MeshLambertMaterial({ map: texture }));
  ground.receiveShadow = true;
  return ground;
}

/** Ruler along x with its zero mark at the origin: ticks every 1 cm, labels every 5 cm. */
export function makeRuler({ ruler, ink }: Theme): THREE.Group {
  const group = new THREE.Group();
  const pixels = 48; // per cm
  for (let first: number = rulerCm[0]; first < rulerCm[1]; first += tileCm) {
    const texture = paint(tileCm * pixels, 80, (context) => {
      context.fillStyle = ruler;
      context.fillRect(0, 0, tileCm * pixels, 80);
      context.fillStyle = ink;
      context.font = "600 30px system-ui, sans-serif";
      context.textAlign = "center";
      for (let cm = 0; cm <= tileCm; cm++) {
        const isFifth = (first + cm) % 5 === 0;
        context.fillRect(cm * pixels - 1.5, 0, 3, isFifth ? 32 : 18);
        if (isFifth) context.fillText(`${first + cm} cm`, cm * pixels, 68);
      }
    });
    const tile = new THREE.Mesh(
      new THREE.PlaneGeometry(tileCm / 100, 0.0165),
      new THREE.MeshBasicMaterial({ map: texture }),
    );
    tile.position.set((first + tileCm / 2) / 100, 0, 0.0004);
    group.add(tile);
  }
  return group;
}
