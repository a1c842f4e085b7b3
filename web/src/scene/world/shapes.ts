import { BoxGeometry, CylinderGeometry, Mesh, TorusGeometry, type BufferGeometry, type Material } from "three";

type Triple = readonly [number, number, number];

export function box(material: Material, size: Triple, place: Triple): Mesh {
  return shaped(new BoxGeometry(...size), material, ...place);
}

export function rodX(material: Material, radius: number, length: number, x: number, y: number, z: number): Mesh {
  const mesh = shaped(new CylinderGeometry(radius, radius, length, 20), material, x, y, z);
  mesh.rotation.z = Math.PI / 2;
  return mesh;
}

export function rodZ(material: Material, radius: number, length: number, x: number, y: number, z: number): Mesh {
  const mesh = shaped(new CylinderGeometry(radius, radius, length, 20), material, x, y, z);
  mesh.rotation.x = Math.PI / 2;
  return mesh;
}

export function hoop(material: Material, radius: number, thick: number, x: number, y: number, z: number): Mesh {
  const mesh = shaped(new TorusGeometry(radius, thick, 8, 40), material, x, y, z);
  mesh.rotation.x = Math.PI / 2;
  return mesh;
}

export function shaped(geometry: BufferGeometry, material: Material, x = 0, y = 0, z = 0): Mesh {
  const mesh = new Mesh(geometry, material);
  mesh.position.set(x, y, z);
  return mesh;
}
