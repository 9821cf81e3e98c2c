// The table of pages: by the first word of the address, and of a telescope by the word after its name.
import { Network } from "./pages/network.js";
import { Telescope } from "./pages/telescope.js";

export const pages = {
  network: {
    network: { title: "Network", Page: Network },
  },
  telescope: {
    now: { title: "Now", Page: Telescope },
  },
};
