"""All that draws: pictures, pages for the browser, waveforms."""
