import { describe, expect, it } from "vitest";
import { isThisComputerOnly, viewersLink } from "../src/api/client";

describe("the viewer's link", () => {
  it("shows the same view, with the viewer's token and no other", () => {
    const here = new URL("http://lab:8080/?token=mine#/fly?drone=2");
    expect(viewersLink("/?token=watch", here)).toBe("http://lab:8080/?token=watch#/fly?drone=2");
  });
  it("is known to lead to this computer only", () => {
    for (const there of ["http://127.0.0.1:8080/", "http://localhost/", "http://[::1]:1/"])
      expect(isThisComputerOnly(new URL(there))).toBe(true);
    for (const there of ["http://lab:8080/", "http://192.168.1.2/", "http://127.0.0.1.example/"])
      expect(isThisComputerOnly(new URL(there))).toBe(false);
  });
});
