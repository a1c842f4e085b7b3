import { BoxGeometry, CylinderGeometry, Mesh, TorusGeometry, type BufferGeometry, type Material } from "three";

export function box(
  material: Material,
  [width, height, depth]: readonly [number, number, number],
  [x, y, z]: readonly [number, number, number],
): Mesh {
  return at(new Mesh(new BoxGeometry(width, height, depth), material), x, y, z);
}

export function rodX(material: Material, radius: number, length: number, x: number, y: number, z: number): Mesh {
  const mesh = at(new Mesh(new CylinderGeometry(radius, radius, length, 20), material), x, y, z);
  mesh.rotation.z = Math.PI / 2;
  return mesh;
}

export function rodZ(material: Material, radius: number, length: number, x: number, y: number, z: number): Mesh {
  const mesh = at(new Mesh(new CylinderGeometry(radius, radius, length, 20), material), x, y, z);
  mesh.rotation.x = Math.PI / 2;
  return mesh;
}

export function hoop(material: Material, radius: number, thick: number, x: number, y: number, z: number): Mesh {
  const mesh = at(new Mesh(new TorusGeometry(radius, thick, 8, 40), material), x, y, z);
  mesh.rotation.x = Math.PI / 2;
  return mesh;
}

export function shaped(geometry: BufferGeometry, material: Material, x = 0, y = 0, z = 0): Mesh {
  return at(new Mesh(geometry, material), x, y, z);
}

function at(mesh: Mesh, x: number, y: number, z: number): Mesh {
  mesh.position.set(x, y, z);
  return mesh;
}
