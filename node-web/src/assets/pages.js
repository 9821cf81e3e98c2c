// The table of pages: by the first word of the address, and of a telescope by the word after its name. Each comes when it is shown.
import { html } from "./lib.js";
import { route } from "./route.js";

/** Below the address of the frames, each frame has its own page. */
const frameOrFrames = ({ Frame }, { Frames }) => (props) => (route.value.rest.length ? html`<${Frame} ...${props} />` : html`<${Frames} ...${props} />`);

export const pages = {
  network: {
    network: { title: "Network", load: async () => (await import("./pages/network.js")).Network },
    alerts: { title: "Alerts", load: async () => (await import("./pages/alerts.js")).Alerts },
    weather: { title: "Weather", load: async () => (await import("./pages/weather.js")).AllWeather },
    frames: { title: "Frames", load: async () => (await import("./pages/frames.js")).Frames },
    report: { title: "Night report", load: async () => (await import("./pages/report.js")).AllReports },
    log: { title: "Log", load: async () => (await import("./pages/log.js")).Log },
    nodes: { title: "Nodes", load: async () => (await import("./pages/nodes.js")).Nodes },
    audit: { title: "Audit", load: async () => (await import("./pages/audit.js")).Audit },
    settings: { title: "Settings and users", load: async () => (await import("./pages/settings.js")).Settings },
    wall: { title: "Wall", load: async () => (await import("./pages/wall.js")).Wall },
  },
  telescope: {
    now: { title: "Now", load: async () => (await import("./pages/telescope.js")).Telescope },
    guiding: { title: "Guiding", load: async () => (await import("./pages/guiding.js")).Guiding },
    focus: { title: "Focus", load: async () => (await import("./pages/focus.js")).Focus },
    lightcurve: { title: "Light curve", load: async () => (await import("./pages/lightcurve.js")).LightCurve },
    schedule: { title: "Schedule", load: async () => (await import("./pages/schedule.js")).Schedule },
    frames: { title: "Frames", load: async () => frameOrFrames(await import("./pages/frame.js"), await import("./pages/frames.js")) },
    weather: { title: "Weather", load: async () => (await import("./pages/weather.js")).Weather },
    devices: { title: "Devices", load: async () => (await import("./pages/device.js")).DevicePage },
    report: { title: "Report", load: async () => (await import("./pages/report.js")).Report },
    controls: { title: "Controls", load: async () => (await import("./pages/controls.js")).Controls },
    log: { title: "Log", load: async () => (await import("./pages/log.js")).Log },
    audit: { title: "Audit", load: async () => (await import("./pages/audit.js")).Audit },
  },
};
