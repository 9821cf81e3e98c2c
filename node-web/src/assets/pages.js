// The table of pages: by the first word of the address, and of a telescope by the word after its name.
import { html } from "./lib.js";
import { Alerts } from "./pages/alerts.js";
import { Audit } from "./pages/audit.js";
import { Controls } from "./pages/controls.js";
import { DevicePage } from "./pages/device.js";
import { Focus } from "./pages/focus.js";
import { Frame } from "./pages/frame.js";
import { Frames } from "./pages/frames.js";
import { Guiding } from "./pages/guiding.js";
import { LightCurve } from "./pages/lightcurve.js";
import { Log } from "./pages/log.js";
import { Network } from "./pages/network.js";
import { Nodes } from "./pages/nodes.js";
import { AllReports, Report } from "./pages/report.js";
import { Schedule } from "./pages/schedule.js";
import { Settings } from "./pages/settings.js";
import { Telescope } from "./pages/telescope.js";
import { Wall } from "./pages/wall.js";
import { AllWeather, Weather } from "./pages/weather.js";
import { route } from "./route.js";

const FrameOrFrames = (props) => (route.value.rest.length ? html`<${Frame} ...${props} />` : html`<${Frames} ...${props} />`);

export const pages = {
  network: {
    network: { title: "Network", Page: Network },
    alerts: { title: "Alerts", Page: Alerts },
    weather: { title: "Weather", Page: AllWeather },
    frames: { title: "Frames", Page: Frames },
    report: { title: "Night report", Page: AllReports },
    log: { title: "Log", Page: Log },
    nodes: { title: "Nodes", Page: Nodes },
    audit: { title: "Audit", Page: Audit },
    settings: { title: "Settings and users", Page: Settings },
    wall: { title: "Wall", Page: Wall },
  },
  telescope: {
    now: { title: "Now", Page: Telescope },
    guiding: { title: "Guiding", Page: Guiding },
    focus: { title: "Focus", Page: Focus },
    lightcurve: { title: "Light curve", Page: LightCurve },
    schedule: { title: "Schedule", Page: Schedule },
    frames: { title: "Frames", Page: FrameOrFrames },
    weather: { title: "Weather", Page: Weather },
    devices: { title: "Devices", Page: DevicePage },
    report: { title: "Report", Page: Report },
    controls: { title: "Controls", Page: Controls },
    log: { title: "Log", Page: Log },
    audit: { title: "Audit", Page: Audit },
  },
};
